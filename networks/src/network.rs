//! A network: an encoder for the kind of observation, hidden layers, and linear heads (Appendix G.2).
//!
//! The encoder turns a row's observations into features. Extra inputs, such as an action, are appended to them. The
//! hidden layers follow.

use std::ops::Range;

use nalgebra::DMatrix;
use protocol::seed::Stream;

use crate::batch::{Batch, RowSize};
use crate::encoder::{Encoder, EncoderMemory, Indexed, PreparedEncoder, WindowIndex};
use crate::layer::activation::Activation;
use crate::layer::dense::{Dense, Panels};
use crate::layer::reshape;
use crate::layer::stack::{GradientMemory, Stack};
use crate::shape::NetworkShape;

/// The layers of a network; its parameters are a flat slice kept elsewhere.
#[derive(Clone, Debug)]
pub struct Network {
    shape: NetworkShape,
    encoder: Encoder,
    /// The hidden layers and the heads.
    layers: Stack,
    /// Parameter range of each layer.
    ranges: Vec<Range<usize>>,
}

/// One version of a network's parameters, packed for the kernels. Any number of threads may share it.
#[derive(Clone, Debug, Default)]
pub struct Prepared {
    encoder: PreparedEncoder,
    panels: Vec<Panels>,
}

/// Memory of one thread for evaluating a network. It grows to the largest batch and is then reused. After
/// [`Network::forward`] it holds what [`Network::backward`] needs.
#[derive(Clone, Debug, Default)]
pub struct Workspace {
    encoder: EncoderMemory,
    /// Input of every layer after the encoder, and output of the last layer.
    values: Vec<DMatrix<f32>>,
    gradients: GradientMemory,
}

impl Workspace {
    /// Returns the outputs of the last [`Network::forward`], `outputs x rows`.
    ///
    /// # Panics
    /// If there was no evaluation.
    pub fn outputs(&self) -> &DMatrix<f32> {
        self.values.last().expect("a network was evaluated in this workspace")
    }
}

impl Network {
    /// Lays out the network.
    ///
    /// # Panics
    /// If the grid of cells is too small for the convolutions, or there is no convolution.
    pub fn new(shape: NetworkShape) -> Self {
        let encoder = Encoder::new(shape.observation, shape.frames, &shape.cells);
        let mut width = encoder.features() + shape.extra_inputs;
        let mut layers = Vec::new();
        for &hidden in &shape.hidden {
            layers.push(Dense { inputs: width, outputs: hidden, activation: shape.activation });
            width = hidden;
        }
        let outputs = shape.heads.iter().map(|head| head.outputs).sum();
        layers.push(Dense { inputs: width, outputs, activation: Activation::Identity });
        let layers = Stack::new(layers);
        let mut ranges = encoder.parameter_ranges();
        let start = ranges.last().map_or(0, |range| range.end);
        ranges.extend(layers.ranges().iter().map(|range| start + range.start..start + range.end));
        Self { shape, encoder, layers, ranges }
    }

    /// Returns the shape that the network was built from.
    pub fn shape(&self) -> &NetworkShape {
        &self.shape
    }

    /// Returns the size of a row of the batches that the network is evaluated on.
    pub fn row_size(&self) -> RowSize {
        let NetworkShape { observation, frames, extra_inputs, .. } = &self.shape;
        RowSize { observation_bytes: frames * observation.bytes(), extra_inputs: *extra_inputs }
    }

    /// Returns the number of outputs of all heads.
    pub fn outputs(&self) -> usize {
        self.shape.heads.iter().map(|head| head.outputs).sum()
    }

    /// Returns the length of the flat parameters.
    pub fn parameter_count(&self) -> usize {
        self.ranges.last().expect("there is an output layer").end
    }

    /// Returns the range of each layer's parameters, from the first layer to the last.
    pub fn parameter_ranges(&self) -> &[Range<usize>] {
        &self.ranges
    }

    /// Returns the length of the encoder's parameters, which come first.
    fn encoder_parameters(&self) -> usize {
        self.parameter_count() - self.layers.parameter_count()
    }

    /// Draws initial parameters.
    pub fn initial_parameters(&self, stream: &mut Stream) -> Vec<f32> {
        let mut parameters = self.encoder.initial_parameters(stream);
        let (last, hidden) = self.layers.layers().split_last().expect("there is an output layer");
        for layer in hidden {
            let initialization = self.shape.hidden_initialization;
            parameters.extend(initialization.draw(layer.inputs, layer.outputs, stream));
        }
        let fan_in = last.inputs;
        let mut heads: Vec<_> = (self.shape.heads.iter())
            .map(|head| head.initialization.draw(fan_in, head.outputs, stream))
            .map(Vec::into_iter)
            .collect();
        for _ in 0..=fan_in {
            for (numbers, head) in heads.iter_mut().zip(&self.shape.heads) {
                parameters.extend(numbers.take(head.outputs));
            }
        }
        parameters
    }

    /// Packs a version of the parameters for evaluation.
    ///
    /// # Panics
    /// If their number is not [`Network::parameter_count`].
    pub fn prepare(&self, parameters: &[f32]) -> Prepared {
        let mut prepared = Prepared::default();
        self.prepare_into(parameters, &mut prepared);
        prepared
    }

    /// Packs a version of the parameters into the memory of an earlier one.
    ///
    /// # Panics
    /// If their number is not [`Network::parameter_count`].
    pub fn prepare_into(&self, parameters: &[f32], prepared: &mut Prepared) {
        assert_eq!(parameters.len(), self.parameter_count(), "parameters of this network");
        let (encoder, layers) = parameters.split_at(self.encoder_parameters());
        self.encoder.prepare(encoder, &mut prepared.encoder);
        self.layers.prepare(layers, &mut prepared.panels);
    }

    /// Finds the distinct windows of observations, for this network and all others with the same encoder.
    pub fn index<'a>(&self, observations: &'a [u8], windows: &'a mut WindowIndex) -> Indexed<'a> {
        self.encoder.index(observations, windows)
    }

    /// Evaluates the network and returns its outputs, `outputs x rows`. The bits of a row's outputs depend only on
    /// that row and the parameters.
    ///
    /// # Panics
    /// If the batch is not made of whole rows, or a cell's class is out of range.
    pub fn forward<'w>(
        &self,
        prepared: &Prepared,
        batch: Batch<'_>,
        workspace: &'w mut Workspace,
    ) -> &'w DMatrix<f32> {
        let rows = batch.rows(self.row_size());
        let Workspace { encoder, values, .. } = workspace;
        let input = self.layers.input(values);
        reshape(input, self.encoder.features(), rows);
        self.encoder.forward(&prepared.encoder, batch.observations, encoder, input);
        widen(input, batch.extra_inputs);
        self.layers.forward(&prepared.panels, values);
        workspace.outputs()
    }

    /// Adds the gradient of the parameters to `gradient`, given the gradient of the outputs. The last
    /// [`Network::forward`] in this workspace must have been on the same batch and parameters.
    ///
    /// # Panics
    /// If a shape differs from that of the forward pass.
    pub fn backward(
        &self,
        prepared: &Prepared,
        batch: Batch<'_>,
        workspace: &mut Workspace,
        output_gradient: &DMatrix<f32>,
        gradient: &mut [f32],
    ) {
        assert_eq!(gradient.len(), self.parameter_count(), "parameters of this network");
        assert_eq!(output_gradient.shape(), workspace.outputs().shape(), "outputs x rows");
        let rows = batch.rows(self.row_size());
        assert_eq!(rows, output_gradient.ncols(), "rows of the batch of the forward half");
        let Workspace { encoder, values, gradients } = workspace;
        let (of_encoder, of_layers) = gradient.split_at_mut(self.encoder_parameters());
        gradients.begin(output_gradient);
        let learns = !of_encoder.is_empty();
        self.layers.backward(&prepared.panels, values, gradients, of_layers, learns);
        if learns {
            narrow(&mut gradients.outputs, self.shape.extra_inputs);
            let observations = batch.observations;
            self.encoder.backward(&prepared.encoder, observations, encoder, gradients, of_encoder);
        }
    }

    /// Returns the gradient of the inputs of each row, `numbers x rows`, given the gradient of the outputs. The
    /// last [`Network::forward`] in this workspace must have been with the same parameters. The inputs are the
    /// numbers of vector observations and the extra inputs; for grids they are the extra inputs only.
    /// [`Network::backward`] may be called before or after.
    ///
    /// # Panics
    /// If a shape differs from that of the forward pass.
    pub fn input_gradient<'w>(
        &self,
        prepared: &Prepared,
        workspace: &'w mut Workspace,
        output_gradient: &DMatrix<f32>,
    ) -> &'w DMatrix<f32> {
        assert_eq!(output_gradient.shape(), workspace.outputs().shape(), "outputs x rows");
        let Workspace { values, gradients, .. } = workspace;
        gradients.begin(output_gradient);
        self.layers.input_gradient(&prepared.panels, values, gradients);
        if !self.encoder.is_identity() {
            keep_last(&mut gradients.outputs, self.shape.extra_inputs);
        }
        &gradients.outputs
    }
}

/// Appends each row's extra inputs to its features.
fn widen(values: &mut DMatrix<f32>, extra_inputs: &[f32]) {
    if extra_inputs.is_empty() {
        return;
    }
    let (features, rows) = values.shape();
    let further = extra_inputs.len() / rows;
    let width = features + further;
    reshape(values, width, rows);
    let numbers = values.as_mut_slice();
    for row in (0..rows).rev() {
        numbers.copy_within(row * features..(row + 1) * features, row * width);
        let own = &extra_inputs[row * further..(row + 1) * further];
        numbers[row * width + features..(row + 1) * width].copy_from_slice(own);
    }
}

/// Drops the last `further` features of each row.
fn narrow(values: &mut DMatrix<f32>, further: usize) {
    if further == 0 {
        return;
    }
    let (width, rows) = values.shape();
    let features = width - further;
    let numbers = values.as_mut_slice();
    for row in 0..rows {
        numbers.copy_within(row * width..row * width + features, row * features);
    }
    reshape(values, features, rows);
}

/// Keeps only the last `further` features of each row.
fn keep_last(values: &mut DMatrix<f32>, further: usize) {
    let (width, rows) = values.shape();
    let numbers = values.as_mut_slice();
    for row in 0..rows {
        numbers.copy_within((row + 1) * width - further..(row + 1) * width, row * further);
    }
    reshape(values, further, rows);
}
