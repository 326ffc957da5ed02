//! The affine layer: dense layers and convolutions alike.
//!
//! A convolution slides a window over the image and multiplies what it sees by one matrix; a dense
//! layer is the case of an image of one pixel. Images are rows of pixels with their channels
//! together, so a window is `kernel` contiguous segments and needs no copy. Weights are stored
//! `[window row][window column][input channel][output]`, then the biases.

use super::activation::Activation;
use super::kernel::{COLUMNS, Tile, Vector16, inner, outer, tiles};

/// About how many window positions are worked on together, so that they stay in the cache.
const BLOCK_POSITIONS: usize = 192;

/// An affine map of every window of its input, and the activation behind it.
#[derive(Clone, Debug)]
pub(crate) struct Affine {
    /// Numbers in one row of the input.
    pub(crate) inputs: usize,
    /// Numbers that each window gives.
    outputs: usize,
    /// Contiguous pieces of a window, one a window row.
    segments: usize,
    /// Numbers in a segment.
    segment: usize,
    /// Distance between the segments of a window.
    stride: usize,
    /// Windows in one row of the batch.
    positions: usize,
    /// Where the windows of one block of rows begin.
    starts: Vec<usize>,
    /// What follows the map.
    pub(crate) activation: Activation,
}

/// The weights of an [`Affine`] in the order in which the kernel reads them.
#[derive(Clone, Debug, Default)]
pub(crate) struct Panels {
    /// For every sixteen outputs, one vector for each number in the window.
    forward: Vec<Vector16>,
    /// The biases of every sixteen outputs.
    bias: Vec<Vector16>,
    /// For every sixteen numbers of a segment, one vector for each output.
    backward: Vec<Vector16>,
}

impl Affine {
    /// A dense layer.
    pub(crate) fn dense(inputs: usize, outputs: usize, activation: Activation) -> Self {
        Self::convolution([1, 1, inputs], 1, outputs, activation)
    }

    /// A convolution of stride one without padding over `[height, width, channels]`.
    pub(crate) fn convolution(
        [height, width, channels]: [usize; 3],
        kernel: usize,
        outputs: usize,
        activation: Activation,
    ) -> Self {
        let positions = (height + 1 - kernel) * (width + 1 - kernel);
        let inputs = height * width * channels;
        let windows = |row: usize| {
            (0..=height - kernel).flat_map(move |y| {
                (0..=width - kernel).map(move |x| row * inputs + (y * width + x) * channels)
            })
        };
        Self {
            inputs,
            outputs,
            segments: kernel,
            segment: kernel * channels,
            stride: width * channels,
            positions,
            starts: (0..BLOCK_POSITIONS.div_ceil(positions)).flat_map(windows).collect(),
            activation,
        }
    }

    /// Numbers that one sum runs over.
    pub(crate) fn fan_in(&self) -> usize {
        self.segments * self.segment
    }

    /// Numbers each window gives.
    pub(crate) fn fan_out(&self) -> usize {
        self.outputs
    }

    /// Numbers in one row of the output.
    pub(crate) fn row_outputs(&self) -> usize {
        self.positions * self.outputs
    }

    /// Weights and biases.
    pub(crate) fn parameter_count(&self) -> usize {
        (self.fan_in() + 1) * self.outputs
    }

    /// Packs `parameters` for the kernel, into memory that is kept between versions.
    pub(crate) fn prepare(&self, parameters: &[f32], panels: &mut Panels) {
        let (weights, biases) = parameters.split_at(self.fan_in() * self.outputs);
        panels.bias.clear();
        panels.bias.extend(biases.chunks(COLUMNS).map(Vector16::of));
        panels.forward.clear();
        for column in (0..self.outputs).step_by(COLUMNS) {
            let width = COLUMNS.min(self.outputs - column);
            let rows = weights.chunks_exact(self.outputs);
            panels.forward.extend(rows.map(|row| Vector16::of(&row[column..column + width])));
        }
        panels.backward.clear();
        for segment in weights.chunks_exact(self.segment * self.outputs) {
            for rows in segment.chunks(COLUMNS * self.outputs) {
                let first = panels.backward.len();
                panels.backward.resize(first + self.outputs, Vector16::ZERO);
                for (index, row) in rows.chunks_exact(self.outputs).enumerate() {
                    let vectors = panels.backward[first..].iter_mut();
                    vectors.zip(row).for_each(|(vector, weight)| vector.0[index] = *weight);
                }
            }
        }
    }

    /// Rows that are worked on together.
    fn block_rows(&self) -> usize {
        self.starts.len() / self.positions
    }

    /// Computes `output` from `input`, both one row after another.
    pub(crate) fn forward(&self, panels: &Panels, input: &[f32], output: &mut [f32]) {
        let inputs = input.chunks(self.block_rows() * self.inputs);
        let outputs = output.chunks_mut(self.block_rows() * self.row_outputs());
        for (input, output) in inputs.zip(outputs) {
            let positions = output.len() / self.outputs;
            let all = panels.forward.chunks_exact(self.fan_in()).zip(&panels.bias);
            for (index, (panel, bias)) in all.enumerate() {
                let column = index * COLUMNS;
                tiles(positions, &mut Forward { layer: self, input, panel, bias, column, output });
            }
        }
    }

    /// Adds the gradient of the parameters to `gradient`, for the `output_gradients` of the sums.
    pub(crate) fn parameter_gradient(
        &self,
        input: &[f32],
        output_gradients: &[f32],
        vectors: &mut Vec<Vector16>,
        gradient: &mut [f32],
    ) {
        let (weights, biases) = gradient.split_at_mut(self.fan_in() * self.outputs);
        let inputs = input.chunks(self.block_rows() * self.inputs);
        for (input, output_gradients) in
            inputs.zip(output_gradients.chunks(self.block_rows() * self.row_outputs()))
        {
            for (index, biases) in biases.chunks_mut(COLUMNS).enumerate() {
                let columns = index * COLUMNS..index * COLUMNS + biases.len();
                vectors.clear();
                let rows = output_gradients.chunks_exact(self.outputs);
                vectors.extend(rows.map(|row| Vector16::of(&row[columns.clone()])));
                vectors.iter().for_each(|vector| vector.add_to(biases));
                for segment in 0..self.segments {
                    let input = &input[segment * self.stride..];
                    let weights = &mut weights[segment * self.segment * self.outputs..];
                    let columns = columns.clone();
                    let mut tile = WeightGradient { layer: self, input, vectors, columns, weights };
                    tiles(self.segment, &mut tile);
                }
            }
        }
    }

    /// Writes the gradient of the input to `gradient`, for the `output_gradients` of the sums.
    pub(crate) fn input_gradient(
        &self,
        panels: &Panels,
        output_gradients: &[f32],
        gradient: &mut [f32],
    ) {
        gradient.fill(0.0);
        let output_gradients = output_gradients.chunks(self.block_rows() * self.row_outputs());
        for (output_gradients, gradient) in
            output_gradients.zip(gradient.chunks_mut(self.block_rows() * self.inputs))
        {
            let pieces = self.segment.div_ceil(COLUMNS);
            for (index, panel) in panels.backward.chunks_exact(self.outputs).enumerate() {
                let (segment, column) = (index / pieces, index % pieces * COLUMNS);
                let offset = segment * self.stride + column;
                let width = COLUMNS.min(self.segment - column);
                let mut tile =
                    InputGradient { layer: self, output_gradients, panel, offset, width, gradient };
                tiles(output_gradients.len() / self.outputs, &mut tile);
            }
        }
    }
}

/// Outputs of some windows.
struct Forward<'a> {
    layer: &'a Affine,
    input: &'a [f32],
    panel: &'a [Vector16],
    bias: &'a Vector16,
    column: usize,
    output: &'a mut [f32],
}

impl Tile for Forward<'_> {
    #[inline]
    fn run<const R: usize>(&mut self, first: usize) {
        let &Affine { segment, stride, outputs, .. } = self.layer;
        let starts: &[usize; R] = self.layer.starts[first..].first_chunk().expect("inside a block");
        let mut sums = [*self.bias; R];
        for (index, panel) in self.panel.chunks_exact(segment).enumerate() {
            let rows = starts.map(|start| &self.input[start + index * stride..][..segment]);
            sums = inner(sums, rows, panel);
        }
        let width = COLUMNS.min(outputs - self.column);
        let rows = self.output[first * outputs..].chunks_exact_mut(outputs);
        for (row, sums) in rows.zip(&mut sums) {
            self.layer.activation.apply(&mut sums.0);
            row[self.column..self.column + width].copy_from_slice(&sums.0[..width]);
        }
    }
}

/// Gradient of some rows of the weights; a tile's rows are the numbers of a segment.
struct WeightGradient<'a> {
    layer: &'a Affine,
    input: &'a [f32],
    vectors: &'a [Vector16],
    columns: std::ops::Range<usize>,
    weights: &'a mut [f32],
}

impl Tile for WeightGradient<'_> {
    #[inline]
    fn run<const R: usize>(&mut self, first: usize) {
        let outputs = self.layer.outputs;
        let sums = outer::<R>(&self.input[first..], &self.layer.starts, self.vectors);
        let rows = self.weights[first * outputs..].chunks_exact_mut(outputs);
        for (row, sums) in rows.zip(&sums) {
            sums.add_to(&mut row[self.columns.clone()]);
        }
    }
}

/// Gradient of up to sixteen numbers of the same segment in some windows. Windows overlap; a number
/// of the input is added to in ascending order of panel, then window, however the tiles fall.
struct InputGradient<'a> {
    layer: &'a Affine,
    output_gradients: &'a [f32],
    panel: &'a [Vector16],
    offset: usize,
    width: usize,
    gradient: &'a mut [f32],
}

impl Tile for InputGradient<'_> {
    #[inline]
    fn run<const R: usize>(&mut self, first: usize) {
        let outputs = self.layer.outputs;
        let rows =
            std::array::from_fn(|row| &self.output_gradients[(first + row) * outputs..][..outputs]);
        let sums = inner([Vector16::ZERO; R], rows, self.panel);
        for (start, sums) in self.layer.starts[first..].iter().zip(&sums) {
            sums.add_to(&mut self.gradient[start + self.offset..][..self.width]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Numbers without a pattern that a wrong index could hide behind.
    fn numbers(count: usize, seed: u32) -> Vec<f32> {
        let mut state = seed.wrapping_mul(2_654_435_761).wrapping_add(12_345);
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1 << 23) as f32 - 1.0
        };
        (0..count).map(|_| next()).collect()
    }

    /// Every pair of an input number and a weight row that meets it, with the output position.
    fn meetings(layer: &Affine, rows: usize) -> Vec<(usize, usize, usize)> {
        let row_starts = &layer.starts[..layer.positions];
        let mut found = Vec::new();
        for row in 0..rows {
            for (position, start) in row_starts.iter().enumerate() {
                for inner in 0..layer.fan_in() {
                    let (segment, column) = (inner / layer.segment, inner % layer.segment);
                    let input = row * layer.inputs + start + segment * layer.stride + column;
                    found.push((row * layer.positions + position, inner, input));
                }
            }
        }
        found
    }

    proptest! {
        #[test]
        fn sums_are_plain_chains_in_ascending_order(
            height in 1..6_usize, width in 1..6_usize, channels in 1..20_usize,
            kernel in 1..3_usize, outputs in 1..40_usize, rows in 1..9_usize, seed: u32,
        ) {
            let kernel = kernel.min(height).min(width);
            let image = [height, width, channels];
            let layer = Affine::convolution(image, kernel, outputs, Activation::Identity);
            let parameters = numbers(layer.parameter_count(), seed);
            let input = numbers(rows * layer.inputs, seed ^ 1);
            let output_gradients = numbers(rows * layer.row_outputs(), seed ^ 2);
            let (weights, biases) = parameters.split_at(layer.fan_in() * outputs);
            let mut panels = Panels::default();
            layer.prepare(&parameters, &mut panels);

            let mut output = vec![0.0; output_gradients.len()];
            layer.forward(&panels, &input, &mut output);
            let mut expected = biases.repeat(rows * layer.positions);
            let mut weight_gradients = vec![0.0; parameters.len()];
            let mut input_gradients = vec![0.0; input.len()];
            for (position, inner, at) in meetings(&layer, rows) {
                for column in 0..outputs {
                    let (out, weight) = (position * outputs + column, inner * outputs + column);
                    expected[out] = input[at].mul_add(weights[weight], expected[out]);
                    weight_gradients[weight] += f64::from(input[at]) * f64::from(output_gradients[out]);
                    input_gradients[at] += f64::from(weights[weight]) * f64::from(output_gradients[out]);
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
