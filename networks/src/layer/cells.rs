//! The first layer over a grid of cells: convolution, rectifier and maximum pooling in one step.
//!
//! The input is one class per cell, which the paper's network sees as one-hot channels. The product of the weights
//! with a one-hot vector is a row of the weights. So the convolution is a sum of table rows, one for each cell of
//! the window, and the one-hot image is never built. Weights are stored as
//! `[frame][window row][window column][class][channel]`, followed by the biases.

use super::activation::rectify;
use super::kernel::{COLUMNS, Vector16};

/// A convolution with stride one over squares of cells, a rectifier, and pooling of each square to one pixel (the
/// first maximum wins).
#[derive(Clone, Debug)]
pub(crate) struct Cells {
    /// Cells of a square, over all frames.
    cells: usize,
    classes: usize,
    /// Numbers per pixel.
    pub(crate) channels: usize,
    /// Offsets of a window's cells from its first cell.
    window: Vec<usize>,
    /// Offsets of the windows of a square.
    corners: Vec<usize>,
}

impl Cells {
    /// Creates the layer over squares that are `pool + kernel - 1` cells wide and have `frames` frames.
    pub(crate) fn new(
        frames: usize,
        classes: usize,
        kernel: usize,
        pool: usize,
        channels: usize,
    ) -> Self {
        let width = pool + kernel - 1;
        let grid = |side: usize| (0..side).flat_map(move |y| (0..side).map(move |x| y * width + x));
        let frame = |index: usize| grid(kernel).map(move |at| index * width * width + at);
        Self {
            cells: frames * width * width,
            classes,
            channels,
            window: (0..frames).flat_map(frame).collect(),
            corners: grid(pool).collect(),
        }
    }

    /// Returns the number of inputs to one sum.
    pub(crate) fn fan_in(&self) -> usize {
        self.window.len() * self.classes
    }

    /// Returns the number of weights and biases.
    pub(crate) fn parameter_count(&self) -> usize {
        (self.fan_in() + 1) * self.channels
    }

    /// Packs `parameters` as a table. For each group of sixteen channels, it has one vector for each cell of the
    /// window and class, then one vector for the bias.
    pub(crate) fn prepare(&self, parameters: &[f32], table: &mut Vec<Vector16>) {
        table.clear();
        for column in (0..self.channels).step_by(COLUMNS) {
            let width = COLUMNS.min(self.channels - column);
            let rows = parameters.chunks_exact(self.channels);
            table.extend(rows.map(|row| Vector16::of(&row[column..column + width])));
        }
    }

    /// Computes one pixel for each square and, for each of its numbers, the window that it came from.
    ///
    /// # Panics
    /// If a cell's class is not below the number of classes.
    pub(crate) fn forward(
        &self,
        table: &[Vector16],
        squares: &[u8],
        pixels: &mut [f32],
        winners: &mut [u8],
    ) {
        let largest = squares.iter().fold(0, |largest, &class| class.max(largest));
        assert!(usize::from(largest) < self.classes, "cell class {largest} of {}", self.classes);
        let pixels = pixels.chunks_exact_mut(self.channels);
        let pixels = pixels.zip(winners.chunks_exact_mut(self.channels));
        for (cells, (pixel, winners)) in squares.chunks_exact(self.cells).zip(pixels) {
            let tables = table.chunks_exact(self.fan_in() + 1);
            let pieces = pixel.chunks_mut(COLUMNS).zip(winners.chunks_mut(COLUMNS));
            for (table, (pixel, winners)) in tables.zip(pieces) {
                let (best, winner) = self.pool(table, cells);
                pixel.copy_from_slice(&best.0[..pixel.len()]);
                winners.copy_from_slice(&winner[..winners.len()]);
            }
        }
    }

    /// Returns the largest sums over the windows of a square, rectified, and the windows that gave them.
    #[inline(always)]
    fn pool(&self, table: &[Vector16], cells: &[u8]) -> (Vector16, [u8; COLUMNS]) {
        let mut best = [f32::NEG_INFINITY; COLUMNS];
        let mut winner = [0_u32; COLUMNS];
        for (index, &corner) in self.corners.iter().enumerate() {
            let mut sums = table[self.fan_in()];
            for (cell, &offset) in self.window.iter().enumerate() {
                let row = &table[cell * self.classes + usize::from(cells[corner + offset])];
                row.add_to(&mut sums.0);
            }
            for ((best, winner), sum) in best.iter_mut().zip(&mut winner).zip(sums.0) {
                let wins = sum > *best;
                *best = if wins { sum } else { *best };
                *winner = if wins { index as u32 } else { *winner };
            }
        }
        (Vector16(best.map(rectify)), winner.map(|winner| winner as u8))
    }

    /// Adds the gradient of the parameters to `gradient`, given the gradient of the pixels before the rectifier.
    pub(crate) fn parameter_gradient(
        &self,
        squares: &[u8],
        winners: &[u8],
        pixel_gradients: &[f32],
        table: &mut Vec<Vector16>,
        gradient: &mut [f32],
    ) {
        for column in (0..self.channels).step_by(COLUMNS) {
            let columns = column..self.channels.min(column + COLUMNS);
            table.clear();
            table.resize(self.fan_in() + 1, Vector16::ZERO);
            let pixels = pixel_gradients.chunks_exact(self.channels);
            let pixels = pixels.zip(winners.chunks_exact(self.channels));
            for (cells, (pixel, winners)) in squares.chunks_exact(self.cells).zip(pixels) {
                let mut winner = [0; COLUMNS];
                winner[..columns.len()].copy_from_slice(&winners[columns.clone()]);
                self.spread(cells, Vector16::of(&pixel[columns.clone()]), winner, table);
            }
            for (row, sums) in gradient.chunks_exact_mut(self.channels).zip(table.iter()) {
                sums.add_to(&mut row[columns.clone()]);
            }
        }
    }

    /// Adds the gradient of a square's pixel to the table rows that were summed for it.
    #[inline(always)]
    fn spread(&self, cells: &[u8], pixel: Vector16, winner: [u8; COLUMNS], table: &mut [Vector16]) {
        for (index, &corner) in self.corners.iter().enumerate() {
            let mut own = pixel;
            for (own, winner) in own.0.iter_mut().zip(winner) {
                *own = if usize::from(winner) == index { *own } else { 0.0 };
            }
            for (cell, &offset) in self.window.iter().enumerate() {
                let row = cell * self.classes + usize::from(cells[corner + offset]);
                own.add_to(&mut table[row].0);
            }
        }
        pixel.add_to(&mut table[self.fan_in()].0);
    }
}
