//! The first layer over a grid of cells: convolution, rectifier and maximum pooling in one.
//!
//! The input is one class per cell, which the paper's network sees as one-hot channels. A product
//! with a one-hot vector is a row of the weights, so the convolution is a sum of table rows, one for
//! each cell of the window, and the one-hot image is never built. Weights are stored
//! `[frame][window row][window column][class][channel]`, then the biases.

use super::activation::rectify;
use super::kernel::{COLUMNS, Vector16};

/// Convolution of stride one, rectifier, and pooling of disjoint squares (the first maximum wins;
/// what does not fill a square is left out).
#[derive(Clone, Debug)]
pub(crate) struct Cells {
    /// Bytes in one row of the batch.
    pub(crate) bytes: usize,
    classes: usize,
    channels: usize,
    /// Where the cells of a window lie, from its first.
    window: Vec<usize>,
    /// Where the windows of a pooled square begin, from its first.
    square: Vec<usize>,
    /// Where the first windows of the pooled squares begin.
    starts: Vec<usize>,
    /// Height, width and channels of the output.
    pub(crate) output: [usize; 3],
}

impl Cells {
    /// The layer over `frames` grids of `[height, width]`.
    pub(crate) fn new(
        frames: usize,
        [height, width]: [usize; 2],
        classes: usize,
        kernel: usize,
        pool: usize,
        channels: usize,
    ) -> Self {
        let grid = |rows: usize, columns: usize, step: usize| {
            (0..rows).flat_map(move |y| (0..columns).map(move |x| (y * width + x) * step))
        };
        let pooled = [(height + 1 - kernel) / pool, (width + 1 - kernel) / pool];
        let frame =
            |index: usize| grid(kernel, kernel, 1).map(move |at| index * height * width + at);
        Self {
            bytes: frames * height * width,
            classes,
            channels,
            window: (0..frames).flat_map(frame).collect(),
            square: grid(pool, pool, 1).collect(),
            starts: grid(pooled[0], pooled[1], pool).collect(),
            output: [pooled[0], pooled[1], channels],
        }
    }

    /// Numbers that one sum runs over.
    pub(crate) fn fan_in(&self) -> usize {
        self.window.len() * self.classes
    }

    /// Numbers in one row of the output.
    pub(crate) fn row_outputs(&self) -> usize {
        self.output.iter().product()
    }

    /// Weights and biases.
    pub(crate) fn parameter_count(&self) -> usize {
        (self.fan_in() + 1) * self.channels
    }

    /// Packs `parameters` as a table: for every sixteen channels a vector for each cell of the window
    /// and class, then one for the bias.
    pub(crate) fn prepare(&self, parameters: &[f32], table: &mut Vec<Vector16>) {
        table.clear();
        for column in (0..self.channels).step_by(COLUMNS) {
            let width = COLUMNS.min(self.channels - column);
            let rows = parameters.chunks_exact(self.channels);
            table.extend(rows.map(|row| Vector16::of(&row[column..column + width])));
        }
    }

    /// Computes `output` and, for each of its numbers, which window of the square it came from.
    ///
    /// # Panics
    /// If a cell's class is not below the number of classes.
    pub(crate) fn forward(
        &self,
        table: &[Vector16],
        observations: &[u8],
        output: &mut [f32],
        winners: &mut [u8],
    ) {
        let largest = observations.iter().fold(0, |largest, &class| class.max(largest));
        assert!(usize::from(largest) < self.classes, "cell class {largest} of {}", self.classes);
        let rows = observations.chunks_exact(self.bytes);
        let outputs = output.chunks_exact_mut(self.row_outputs());
        for ((row, output), winners) in
            rows.zip(outputs).zip(winners.chunks_exact_mut(self.row_outputs()))
        {
            let pixels = output.chunks_exact_mut(self.channels);
            let pixels = pixels.zip(winners.chunks_exact_mut(self.channels));
            for (&start, (output, winners)) in self.starts.iter().zip(pixels) {
                let tables = table.chunks_exact(self.fan_in() + 1);
                let pieces = output.chunks_mut(COLUMNS).zip(winners.chunks_mut(COLUMNS));
                for (table, (output, winners)) in tables.zip(pieces) {
                    let (best, winner) = self.pool(table, &row[start..]);
                    output.copy_from_slice(&best.0[..output.len()]);
                    winners.copy_from_slice(&winner[..winners.len()]);
                }
            }
        }
    }

    /// The largest sums over the windows of the square at the front of `cells`, rectified, and which
    /// window gave them.
    #[inline(always)]
    fn pool(&self, table: &[Vector16], cells: &[u8]) -> (Vector16, [u8; COLUMNS]) {
        let mut best = [f32::NEG_INFINITY; COLUMNS];
        let mut winner = [0_u32; COLUMNS];
        for (index, &corner) in self.square.iter().enumerate() {
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

    /// Adds the gradient of the parameters to `gradient`, for the `output_gradients` of the pooled sums.
    pub(crate) fn parameter_gradient(
        &self,
        observations: &[u8],
        winners: &[u8],
        output_gradients: &[f32],
        table: &mut Vec<Vector16>,
        gradient: &mut [f32],
    ) {
        for column in (0..self.channels).step_by(COLUMNS) {
            let columns = column..self.channels.min(column + COLUMNS);
            table.clear();
            table.resize(self.fan_in() + 1, Vector16::ZERO);
            let rows = observations.chunks_exact(self.bytes);
            let output_gradients = output_gradients.chunks_exact(self.row_outputs());
            for ((row, output_gradients), winners) in
                rows.zip(output_gradients).zip(winners.chunks_exact(self.row_outputs()))
            {
                let pixels = output_gradients.chunks_exact(self.channels);
                let pixels = pixels.zip(winners.chunks_exact(self.channels));
                for (&start, (output_gradients, winners)) in self.starts.iter().zip(pixels) {
                    let mut winner = [0; COLUMNS];
                    winner[..columns.len()].copy_from_slice(&winners[columns.clone()]);
                    self.spread(
                        &row[start..],
                        Vector16::of(&output_gradients[columns.clone()]),
                        winner,
                        table,
                    );
                }
            }
            for (row, sums) in gradient.chunks_exact_mut(self.channels).zip(table.iter()) {
                sums.add_to(&mut row[columns.clone()]);
            }
        }
    }

    /// Adds the output gradients of one pooled square to the table rows that its windows summed.
    #[inline(always)]
    fn spread(
        &self,
        cells: &[u8],
        output_gradients: Vector16,
        winner: [u8; COLUMNS],
        table: &mut [Vector16],
    ) {
        for (index, &corner) in self.square.iter().enumerate() {
            let mut own = output_gradients;
            for (own, winner) in own.0.iter_mut().zip(winner) {
                *own = if usize::from(winner) == index { *own } else { 0.0 };
            }
            for (cell, &offset) in self.window.iter().enumerate() {
                let row = cell * self.classes + usize::from(cells[corner + offset]);
                own.add_to(&mut table[row].0);
            }
        }
        output_gradients.add_to(&mut table[self.fan_in()].0);
    }
}
