//! The dense layer: multiplies every row by one matrix, adds the biases and applies an activation.
//!
//! Weights are stored as `[input][output]`, followed by the biases.

use std::ops::Range;

use super::activation::Activation;
use super::kernel::{COLUMNS, Tile, Vector16, inner, outer, tiles};

/// Rows that are processed together, so that they stay in the cache.
const BLOCK_ROWS: usize = 192;

/// Inputs that are processed together, so that their weights stay in the cache.
const BLOCK_INPUTS: usize = 256;

/// An affine map of rows, followed by an activation.
#[derive(Clone, Debug)]
pub(crate) struct Dense {
    /// Numbers per input row.
    pub(crate) inputs: usize,
    /// Numbers per output row.
    pub(crate) outputs: usize,
    /// Activation applied to the sums.
    pub(crate) activation: Activation,
}

/// The weights of a [`Dense`] layer in the order in which the kernel reads them.
#[derive(Clone, Debug, Default)]
pub(crate) struct Panels {
    /// One vector per input for each group of sixteen outputs.
    forward: Vec<Vector16>,
    /// Biases of each group of sixteen outputs.
    bias: Vec<Vector16>,
    /// One vector per output for each group of sixteen inputs.
    backward: Vec<Vector16>,
}

impl Dense {
    /// Returns the number of weights and biases.
    pub(crate) fn parameter_count(&self) -> usize {
        (self.inputs + 1) * self.outputs
    }

    /// Packs `parameters` for the kernel, reusing the memory of `panels`.
    pub(crate) fn prepare(&self, parameters: &[f32], panels: &mut Panels) {
        let (weights, biases) = parameters.split_at(self.inputs * self.outputs);
        panels.bias.clear();
        panels.bias.extend(biases.chunks(COLUMNS).map(Vector16::of));
        panels.forward.clear();
        for column in (0..self.outputs).step_by(COLUMNS) {
            let width = COLUMNS.min(self.outputs - column);
            let rows = weights.chunks_exact(self.outputs);
            panels.forward.extend(rows.map(|row| Vector16::of(&row[column..column + width])));
        }
        panels.backward.clear();
        for rows in weights.chunks(COLUMNS * self.outputs) {
            let first = panels.backward.len();
            panels.backward.resize(first + self.outputs, Vector16::ZERO);
            for (index, row) in rows.chunks_exact(self.outputs).enumerate() {
                let vectors = panels.backward[first..].iter_mut();
                vectors.zip(row).for_each(|(vector, weight)| vector.0[index] = *weight);
            }
        }
    }

    /// Computes `output` from `input`, both stored row by row.
    pub(crate) fn forward(&self, panels: &Panels, input: &[f32], output: &mut [f32]) {
        let inputs = input.chunks(BLOCK_ROWS * self.inputs);
        for (input, output) in inputs.zip(output.chunks_mut(BLOCK_ROWS * self.outputs)) {
            let rows = output.len() / self.outputs;
            let all = panels.forward.chunks_exact(self.inputs).zip(&panels.bias);
            for (index, (panel, bias)) in all.enumerate() {
                for (block, panel) in panel.chunks(BLOCK_INPUTS).enumerate() {
                    let (column, first_input) = (index * COLUMNS, block * BLOCK_INPUTS);
                    let layer = self;
                    let mut tile =
                        Forward { layer, input, panel, bias, column, first_input, output };
                    tiles(rows, &mut tile);
                }
            }
        }
    }

    /// Adds the gradient of the parameters to `gradient`, given the `output_gradients` before the activation.
    pub(crate) fn parameter_gradient(
        &self,
        input: &[f32],
        output_gradients: &[f32],
        vectors: &mut Vec<Vector16>,
        gradient: &mut [f32],
    ) {
        let (weights, biases) = gradient.split_at_mut(self.inputs * self.outputs);
        let inputs = input.chunks(BLOCK_ROWS * self.inputs);
        for (input, output_gradients) in
            inputs.zip(output_gradients.chunks(BLOCK_ROWS * self.outputs))
        {
            for (index, biases) in biases.chunks_mut(COLUMNS).enumerate() {
                let columns = index * COLUMNS..index * COLUMNS + biases.len();
                vectors.clear();
                let rows = output_gradients.chunks_exact(self.outputs);
                vectors.extend(rows.map(|row| Vector16::of(&row[columns.clone()])));
                vectors.iter().for_each(|vector| vector.add_to(biases));
                let mut tile = WeightGradient { layer: self, input, vectors, columns, weights };
                tiles(self.inputs, &mut tile);
            }
        }
    }

    /// Writes the gradient of the input to `gradient`, given the `output_gradients` before the activation.
    pub(crate) fn input_gradient(
        &self,
        panels: &Panels,
        output_gradients: &[f32],
        gradient: &mut [f32],
    ) {
        let output_gradients = output_gradients.chunks(BLOCK_ROWS * self.outputs);
        for (output_gradients, gradient) in
            output_gradients.zip(gradient.chunks_mut(BLOCK_ROWS * self.inputs))
        {
            for (index, panel) in panels.backward.chunks_exact(self.outputs).enumerate() {
                let column = index * COLUMNS;
                let mut tile =
                    InputGradient { layer: self, output_gradients, panel, column, gradient };
                tiles(output_gradients.len() / self.outputs, &mut tile);
            }
        }
    }
}

/// Sixteen outputs of some rows, computed from a block of their inputs. Unless it is the first block, the sums
/// continue from the values that the previous blocks have left in `output`.
struct Forward<'a> {
    layer: &'a Dense,
    input: &'a [f32],
    panel: &'a [Vector16],
    bias: &'a Vector16,
    column: usize,
    first_input: usize,
    output: &'a mut [f32],
}

impl Tile for Forward<'_> {
    #[inline]
    fn run<const R: usize>(&mut self, first: usize) {
        let &Dense { inputs, outputs, activation } = self.layer;
        let width = COLUMNS.min(outputs - self.column);
        let rows = std::array::from_fn(|row| {
            &self.input[(first + row) * inputs + self.first_input..][..self.panel.len()]
        });
        let mut sums = [*self.bias; R];
        let output = &mut self.output[first * outputs + self.column..];
        if self.first_input > 0 {
            for (row, sums) in output.chunks(outputs).zip(&mut sums) {
                *sums = Vector16::of(&row[..width]);
            }
        }
        let mut sums = inner(sums, rows, self.panel);
        let is_last = self.first_input + self.panel.len() == inputs;
        for (row, sums) in output.chunks_mut(outputs).zip(&mut sums) {
            if is_last {
                activation.apply(&mut sums.0);
            }
            row[..width].copy_from_slice(&sums.0[..width]);
        }
    }
}

/// Gradient of some rows of the weights.
struct WeightGradient<'a> {
    layer: &'a Dense,
    input: &'a [f32],
    vectors: &'a [Vector16],
    columns: Range<usize>,
    weights: &'a mut [f32],
}

impl Tile for WeightGradient<'_> {
    #[inline]
    fn run<const R: usize>(&mut self, first: usize) {
        let &Dense { inputs, outputs, .. } = self.layer;
        let sums = outer::<R>(self.input, first, inputs, self.vectors);
        let rows = self.weights[first * outputs..].chunks_exact_mut(outputs);
        for (row, sums) in rows.zip(&sums) {
            sums.add_to(&mut row[self.columns.clone()]);
        }
    }
}

/// Gradient of up to sixteen inputs of some rows.
struct InputGradient<'a> {
    layer: &'a Dense,
    output_gradients: &'a [f32],
    panel: &'a [Vector16],
    column: usize,
    gradient: &'a mut [f32],
}

impl Tile for InputGradient<'_> {
    #[inline]
    fn run<const R: usize>(&mut self, first: usize) {
        let &Dense { inputs, outputs, .. } = self.layer;
        let columns = self.column..inputs.min(self.column + COLUMNS);
        let rows =
            std::array::from_fn(|row| &self.output_gradients[(first + row) * outputs..][..outputs]);
        let sums = inner([Vector16::ZERO; R], rows, self.panel);
        for (row, sums) in self.gradient[first * inputs..].chunks_exact_mut(inputs).zip(&sums) {
            row[columns.clone()].copy_from_slice(&sums.0[..columns.len()]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Returns irregular numbers, so that no pattern can hide a wrong index.
    fn numbers(count: usize, seed: u32) -> Vec<f32> {
        let mut state = seed.wrapping_mul(2_654_435_761).wrapping_add(12_345);
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1 << 23) as f32 - 1.0
        };
        (0..count).map(|_| next()).collect()
    }

    proptest! {
        #[test]
        fn sums_are_plain_chains_in_ascending_order(
            inputs in 1..600_usize, outputs in 1..40_usize, rows in 1..9_usize, seed: u32,
        ) {
            let layer = Dense { inputs, outputs, activation: Activation::Identity };
            let parameters = numbers(layer.parameter_count(), seed);
            let input = numbers(rows * inputs, seed ^ 1);
            let output_gradients = numbers(rows * outputs, seed ^ 2);
            let (weights, biases) = parameters.split_at(inputs * outputs);
            let mut panels = Panels::default();
            layer.prepare(&parameters, &mut panels);

            let mut output = vec![0.0; rows * outputs];
            layer.forward(&panels, &input, &mut output);
            let mut expected = biases.repeat(rows);
            let mut weight_gradients = vec![0.0; parameters.len()];
            let mut input_gradients = vec![0.0; input.len()];
            for row in 0..rows {
                for inner in 0..inputs {
                    for column in 0..outputs {
                        let (at, out) = (row * inputs + inner, row * outputs + column);
                        let weight = inner * outputs + column;
                        expected[out] = input[at].mul_add(weights[weight], expected[out]);
                        let derivative = f64::from(output_gradients[out]);
                        weight_gradients[weight] += f64::from(input[at]) * derivative;
                        input_gradients[at] += f64::from(weights[weight]) * derivative;
                    }
                }
            }
            prop_assert_eq!(output, expected);
            for (index, derivative) in output_gradients.iter().enumerate() {
                weight_gradients[weights.len() + index % outputs] += f64::from(*derivative);
            }

            let mut gradient = vec![0.0; parameters.len()];
            layer.parameter_gradient(&input, &output_gradients, &mut Vec::new(), &mut gradient);
            let mut input_gradient = vec![f32::NAN; input.len()];
            layer.input_gradient(&panels, &output_gradients, &mut input_gradient);
            let found = gradient.iter().chain(&input_gradient);
            for (found, expected) in found.zip(weight_gradients.iter().chain(&input_gradients)) {
                prop_assert!((f64::from(*found) - expected).abs() < 1e-4, "{found} {expected}");
            }
        }
    }
}
