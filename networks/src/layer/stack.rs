//! Dense layers one after another, with the memory that back-propagation through them needs.

use std::ops::Range;

use nalgebra::DMatrix;

use super::dense::{Dense, Panels};
use super::kernel::Vector16;
use super::{ranges, reshape};

/// Dense layers, each of which reads the output of the previous one.
#[derive(Clone, Debug)]
pub(crate) struct Stack {
    layers: Vec<Dense>,
    /// Parameter range of each layer, relative to the first parameter of the stack.
    ranges: Vec<Range<usize>>,
}

/// Memory of one thread for back-propagation through layers.
#[derive(Clone, Debug)]
pub(crate) struct GradientMemory {
    /// Gradient of the outputs of the layer to be processed next, `features x rows`.
    pub(crate) outputs: DMatrix<f32>,
    inputs: DMatrix<f32>,
    pub(crate) vectors: Vec<Vector16>,
}

impl Default for GradientMemory {
    fn default() -> Self {
        let [outputs, inputs] = [(); 2].map(|()| DMatrix::zeros(0, 0));
        Self { outputs, inputs, vectors: Vec::new() }
    }
}

impl Stack {
    pub(crate) fn new(layers: Vec<Dense>) -> Self {
        let ranges = ranges(layers.iter().map(Dense::parameter_count));
        Self { layers, ranges }
    }

    /// Returns the layers in order.
    pub(crate) fn layers(&self) -> &[Dense] {
        &self.layers
    }

    /// Returns the range of each layer's parameters.
    pub(crate) fn ranges(&self) -> &[Range<usize>] {
        &self.ranges
    }

    /// Returns the number of weights and biases.
    pub(crate) fn parameter_count(&self) -> usize {
        self.ranges.last().map_or(0, |range| range.end)
    }

    /// Packs `parameters` for the kernel.
    pub(crate) fn prepare(&self, parameters: &[f32], panels: &mut Vec<Panels>) {
        panels.resize_with(self.layers.len(), Panels::default);
        for ((layer, range), panels) in self.layers.iter().zip(&self.ranges).zip(panels) {
            layer.prepare(&parameters[range.clone()], panels);
        }
    }

    /// Allocates `values` for the input of every layer and the output of the last one. Returns the input, for the
    /// caller to fill.
    pub(crate) fn input<'v>(&self, values: &'v mut Vec<DMatrix<f32>>) -> &'v mut DMatrix<f32> {
        values.resize_with(self.layers.len() + 1, || DMatrix::zeros(0, 0));
        &mut values[0]
    }

    /// Evaluates the layers, starting from the input in `values[0]`.
    pub(crate) fn forward(&self, panels: &[Panels], values: &mut [DMatrix<f32>]) {
        for (index, (layer, panels)) in self.layers.iter().zip(panels).enumerate() {
            let [input, output] = values
                .get_disjoint_mut([index, index + 1])
                .expect("one more than there are layers");
            reshape(output, layer.outputs, input.ncols());
            layer.forward(panels, input.as_slice(), output.as_mut_slice());
        }
    }

    /// Adds the gradient of the parameters to `gradient`, given the gradient of the outputs in `memory`. If `input`
    /// is set, the gradient of the input replaces that of the outputs in `memory`.
    pub(crate) fn backward(
        &self,
        panels: &[Panels],
        values: &[DMatrix<f32>],
        memory: &mut GradientMemory,
        gradient: &mut [f32],
        input: bool,
    ) {
        for (index, layer) in self.layers.iter().enumerate().rev() {
            memory.through_activation(layer, &values[index + 1]);
            let GradientMemory { outputs, vectors, .. } = memory;
            let own = &mut gradient[self.ranges[index].clone()];
            layer.parameter_gradient(values[index].as_slice(), outputs.as_slice(), vectors, own);
            if index > 0 || input {
                memory.through_layer(layer, &panels[index]);
            }
        }
    }

    /// Replaces the gradient of the outputs in `memory` with the gradient of the input.
    pub(crate) fn input_gradient(
        &self,
        panels: &[Panels],
        values: &[DMatrix<f32>],
        memory: &mut GradientMemory,
    ) {
        for (index, layer) in self.layers.iter().enumerate().rev() {
            memory.through_activation(layer, &values[index + 1]);
            memory.through_layer(layer, &panels[index]);
        }
    }
}

impl GradientMemory {
    /// Starts back-propagation with the gradient of the last layer's outputs.
    pub(crate) fn begin(&mut self, output_gradient: &DMatrix<f32>) {
        reshape(&mut self.outputs, output_gradient.nrows(), output_gradient.ncols());
        self.outputs.copy_from(output_gradient);
    }

    fn through_activation(&mut self, layer: &Dense, outputs: &DMatrix<f32>) {
        layer.activation.backward(outputs.as_slice(), self.outputs.as_mut_slice());
    }

    fn through_layer(&mut self, layer: &Dense, panels: &Panels) {
        reshape(&mut self.inputs, layer.inputs, self.outputs.ncols());
        layer.input_gradient(panels, self.outputs.as_slice(), self.inputs.as_mut_slice());
        std::mem::swap(&mut self.outputs, &mut self.inputs);
    }
}
