//! The encoder of grids of cells (Appendix G.2): convolutions, the first of which is pooled, and a dense layer. A
//! rectifier follows each layer.
//!
//! Every layer computes only the distinct windows of the batch (`layer::distinct`); the dense layer has one window,
//! the whole image. So equal observations cost as much as one, and a change in a grid costs only the windows around
//! it. Gradients of equal windows are summed before they go through a layer.

use std::ops::Range;

use nalgebra::DMatrix;
use protocol::encoder::CellsArchitecture;
use protocol::seed::Stream;

use super::{Observations, PreparedEncoder};
use crate::initialization::Initialization;
use crate::layer::activation::Activation;
use crate::layer::cells::Cells;
use crate::layer::dense::{Dense, Panels};
use crate::layer::distinct::Distinct;
use crate::layer::kernel::Vector16;
use crate::layer::ranges;
use crate::layer::windows::Windows;

/// The layers of the encoder.
#[derive(Clone, Debug)]
pub(crate) struct CellsEncoder {
    squares: Windows,
    first: Cells,
    further: Vec<Layer>,
    /// Parameter range of each layer.
    ranges: Vec<Range<usize>>,
}

/// A layer after the first.
#[derive(Clone, Debug)]
struct Layer {
    /// Windows over the output of the previous layer.
    windows: Windows,
    /// Numbers per pixel of that output.
    channels: usize,
    /// Dense layer applied to each window.
    dense: Dense,
}

/// Memory of one thread for evaluating the encoder and for back-propagation.
#[derive(Clone, Debug, Default)]
pub(crate) struct CellsMemory {
    /// Windows of the last batch, unless it was a whole [`super::Indexed`].
    windows: CellsWindows,
    cells: Vec<u8>,
    pixels: Vec<f32>,
    winners: Vec<u8>,
    further: Vec<LayerMemory>,
    gradients: Gradients,
}

/// Distinct windows of every layer for a set of observations.
#[derive(Clone, Debug, Default)]
pub(crate) struct CellsWindows(Vec<Distinct>);

/// Input and output of a layer.
#[derive(Clone, Debug, Default)]
struct LayerMemory {
    input: Vec<f32>,
    output: Vec<f32>,
}

/// Gradients during back-propagation.
#[derive(Clone, Debug, Default)]
struct Gradients {
    outputs: Vec<f32>,
    inputs: Vec<f32>,
}

impl CellsEncoder {
    /// Lays out the encoder for rows of `frames` grids of `[height, width]` each.
    ///
    /// # Panics
    /// If there is no convolution, or the grid is too small for the convolutions.
    pub(crate) fn new(
        grid: [usize; 2],
        classes: usize,
        frames: usize,
        architecture: &CellsArchitecture,
    ) -> Self {
        let &CellsArchitecture { ref channels, kernel, pool, features } = architecture;
        let (&first, convolutions) = channels.split_first().expect("an encoder has a convolution");
        let squares = Windows::square(frames, grid, pool + kernel - 1, pool);
        let (mut size, mut channels) = (squares.size, first);
        let mut further = Vec::new();
        for &outputs in convolutions {
            let windows = Windows::square(1, size, kernel, 1);
            size = windows.size;
            further.push(Layer::new(windows, channels, outputs));
            channels = outputs;
        }
        further.push(Layer::new(Windows::whole(size), channels, features));
        let first = Cells::new(frames, classes, kernel, pool, first);
        let counts = further.iter().map(|layer| layer.dense.parameter_count());
        let counts = std::iter::once(first.parameter_count()).chain(counts);
        let ranges = ranges(counts);
        Self { squares, first, further, ranges }
    }

    pub(super) fn features(&self) -> usize {
        self.further.last().expect("a dense layer ends the encoder").dense.outputs
    }

    pub(super) fn parameter_ranges(&self) -> &[Range<usize>] {
        &self.ranges
    }

    pub(super) fn initial_parameters(&self, stream: &mut Stream) -> Vec<f32> {
        let first = (self.first.fan_in(), self.first.channels);
        let further = self.further.iter().map(|layer| (layer.dense.inputs, layer.dense.outputs));
        let layers = std::iter::once(first).chain(further);
        layers
            .flat_map(|(fan_in, outputs)| Initialization::FanIn.draw(fan_in, outputs, stream))
            .collect()
    }

    pub(super) fn prepare(&self, parameters: &[f32], prepared: &mut PreparedEncoder) {
        let (first, further) = self.ranges.split_first().expect("an encoder has a convolution");
        self.first.prepare(&parameters[first.clone()], &mut prepared.table);
        prepared.panels.resize_with(self.further.len(), Panels::default);
        for ((layer, range), panels) in self.further.iter().zip(further).zip(&mut prepared.panels) {
            layer.dense.prepare(&parameters[range.clone()], panels);
        }
    }

    pub(super) fn forward(
        &self,
        prepared: &PreparedEncoder,
        observations: Observations<'_>,
        memory: &mut CellsMemory,
        features: &mut DMatrix<f32>,
    ) {
        let CellsMemory { windows, cells, pixels, winners, further, .. } = memory;
        match observations {
            Observations::Bytes(bytes) => self.find_windows(bytes, windows),
            Observations::Rows(indexed, rows) => self.choose(&indexed.windows.cells, rows, windows),
            Observations::Indexed(_) => {}
        }
        let (squares, windows) = windows_of(observations, windows);
        cells.clear();
        cells.extend(squares.pixels.iter().map(|class| *class as u8));
        let numbers = cells.len() / self.squares.len() * self.first.channels;
        pixels.resize(numbers, 0.0);
        winners.resize(numbers, 0);
        self.first.forward(&prepared.table, cells, pixels, winners);
        further.resize_with(self.further.len(), LayerMemory::default);
        let mut outputs = &*pixels;
        let layers = self.further.iter().zip(&prepared.panels).zip(windows);
        for (((layer, panels), distinct), LayerMemory { input, output }) in layers.zip(further) {
            distinct.gather(outputs, layer.channels, input);
            output.resize(distinct.pixels.len() / layer.windows.len() * layer.dense.outputs, 0.0);
            layer.dense.forward(panels, input, output);
            outputs = output;
        }
        let width = self.features();
        let rows = features.as_mut_slice().chunks_exact_mut(width);
        for (&which, row) in last(windows).which.iter().zip(rows) {
            row.copy_from_slice(&outputs[which as usize * width..][..width]);
        }
    }

    /// Finds the distinct windows of every layer.
    pub(super) fn find_windows(&self, observations: &[u8], CellsWindows(found): &mut CellsWindows) {
        found.resize_with(1 + self.further.len(), Distinct::default);
        let (squares, further) = found.split_first_mut().expect("an encoder has a convolution");
        squares.find(&self.squares, observations);
        let mut images = &squares.which;
        for (layer, distinct) in self.further.iter().zip(further) {
            distinct.find(&layer.windows, images);
            images = &distinct.which;
        }
    }

    /// Selects the distinct windows of some rows from those of all rows.
    fn choose(
        &self,
        CellsWindows(all): &CellsWindows,
        rows: &[u32],
        CellsWindows(chosen): &mut CellsWindows,
    ) {
        chosen.resize_with(all.len(), Distinct::default);
        let windows =
            std::iter::once(&self.squares).chain(self.further.iter().map(|layer| &layer.windows));
        let mut below = None;
        for ((windows, of), distinct) in windows.zip(all).zip(chosen) {
            distinct.choose(windows, of, rows, below);
            below = Some(distinct);
        }
    }

    pub(super) fn backward(
        &self,
        prepared: &PreparedEncoder,
        observations: Observations<'_>,
        memory: &mut CellsMemory,
        feature_gradients: &DMatrix<f32>,
        vectors: &mut Vec<Vector16>,
        gradient: &mut [f32],
    ) {
        let CellsMemory { windows, cells, pixels, winners, further, gradients } = memory;
        let Gradients { outputs, inputs } = gradients;
        let (_, windows) = windows_of(observations, windows);
        outputs.clear();
        outputs.resize(further.last().map_or(0, |layer| layer.output.len()), 0.0);
        last(windows).sum(feature_gradients.as_slice(), self.features(), outputs);
        for (index, layer) in self.further.iter().enumerate().rev() {
            let LayerMemory { input, output } = &further[index];
            layer.dense.activation.backward(output, outputs);
            let own = &mut gradient[self.ranges[index + 1].clone()];
            layer.dense.parameter_gradient(input, outputs, vectors, own);
            inputs.resize(input.len(), 0.0);
            layer.dense.input_gradient(&prepared.panels[index], outputs, inputs);
            outputs.clear();
            let before =
                index.checked_sub(1).map_or(pixels.len(), |before| further[before].output.len());
            outputs.resize(before, 0.0);
            windows[index].spread(inputs, layer.channels, outputs);
        }
        Activation::Relu.backward(pixels, outputs);
        let own = &mut gradient[self.ranges[0].clone()];
        self.first.parameter_gradient(cells, winners, outputs, vectors, own);
    }
}

/// Returns the distinct windows of the first layer and those of the later layers, for the last evaluation.
fn windows_of<'a>(
    observations: Observations<'a>,
    found: &'a CellsWindows,
) -> (&'a Distinct, &'a [Distinct]) {
    let CellsWindows(layers) = match observations {
        Observations::Indexed(indexed) => &indexed.windows.cells,
        Observations::Bytes(_) | Observations::Rows(..) => found,
    };
    layers.split_first().expect("windows were found")
}

fn last(windows: &[Distinct]) -> &Distinct {
    windows.last().expect("a dense layer ends the encoder")
}

impl Layer {
    fn new(windows: Windows, channels: usize, outputs: usize) -> Layer {
        let inputs = windows.len() * channels;
        Layer { windows, channels, dense: Dense { inputs, outputs, activation: Activation::Relu } }
    }
}
