//! A network: an encoder by kind of observation, hidden layers, and linear heads (Appendix G.2).
//!
//! Cells pass through convolutions and a dense layer to features, vectors are read as they are;
//! numbers given beside the observation, such as an action, join them; then come the hidden layers.

use std::ops::Range;

use nalgebra::DMatrix;
use protocol::seed::Stream;
use protocol::task::{ObservationSpec, floats};

use crate::batch::{Batch, RowSize};
use crate::initialization::Initialization;
use crate::layer::activation::Activation;
use crate::layer::affine::{Affine, Panels};
use crate::layer::cells::Cells;
use crate::layer::kernel::Vector16;
use crate::shape::NetworkShape;

/// The layers of a network; its parameters are a flat slice kept elsewhere.
#[derive(Clone, Debug)]
pub struct Network {
    shape: NetworkShape,
    cells: Option<Cells>,
    affine: Vec<Affine>,
    /// The affine layer whose input is joined by the numbers beside the observation.
    join: usize,
    /// How the parameters of each affine layer but the last are drawn.
    initializations: Vec<Initialization>,
    /// Where each layer's parameters lie.
    ranges: Vec<Range<usize>>,
}

/// One version of a network's parameters, packed for the kernels. Any number of threads may share it.
#[derive(Clone, Debug, Default)]
pub struct Prepared {
    table: Vec<Vector16>,
    panels: Vec<Panels>,
}

/// What a thread needs to evaluate a network. It grows to the largest batch and is then reused; after
/// [`Network::forward`] it holds what [`Network::backward`] needs.
#[derive(Clone, Debug)]
pub struct Workspace {
    /// The input of every affine layer, and the output of the last.
    values: Vec<DMatrix<f32>>,
    winners: Vec<u8>,
    vectors: Vec<Vector16>,
    output_gradients: DMatrix<f32>,
    input_gradients: DMatrix<f32>,
}

impl Default for Workspace {
    fn default() -> Self {
        let [output_gradients, input_gradients] = [(); 2].map(|()| DMatrix::zeros(0, 0));
        let (values, winners, vectors) = (Vec::new(), Vec::new(), Vec::new());
        Self { values, winners, vectors, output_gradients, input_gradients }
    }
}

impl Workspace {
    /// Outputs of the last [`Network::forward`], `outputs x rows`.
    ///
    /// # Panics
    /// If there was none.
    pub fn outputs(&self) -> &DMatrix<f32> {
        self.values.last().expect("a network was evaluated in this workspace")
    }
}

impl Network {
    /// Lays the layers out.
    ///
    /// # Panics
    /// If the grid of cells is too small for the convolutions, or there is no convolution.
    pub fn new(shape: NetworkShape) -> Self {
        let (mut affine, mut initializations) = (Vec::new(), Vec::new());
        let (cells, mut width) = match shape.observation {
            ObservationSpec::Vector { len } => (None, shape.frames * len),
            ObservationSpec::Cells { height, width, classes } => {
                let (kernel, pool) = (shape.cells.kernel, shape.cells.pool);
                let (&first, further) =
                    shape.cells.channels.split_first().expect("an encoder has a convolution");
                let cells = Cells::new(shape.frames, [height, width], classes, kernel, pool, first);
                let mut image = cells.output;
                for &channels in further {
                    affine.push(Affine::convolution(image, kernel, channels, Activation::Relu));
                    image = [image[0] + 1 - kernel, image[1] + 1 - kernel, channels];
                }
                let features = shape.cells.features;
                affine.push(Affine::dense(image.iter().product(), features, Activation::Relu));
                initializations.resize(affine.len(), Initialization::FanIn);
                (Some(cells), features)
            }
        };
        let join = affine.len();
        width += shape.extra_inputs;
        for &hidden in &shape.hidden {
            affine.push(Affine::dense(width, hidden, shape.activation));
            initializations.push(shape.hidden_initialization);
            width = hidden;
        }
        let outputs = shape.heads.iter().map(|head| head.outputs).sum();
        affine.push(Affine::dense(width, outputs, Activation::Identity));
        let counts = cells.iter().map(Cells::parameter_count);
        let counts = counts.chain(affine.iter().map(Affine::parameter_count));
        let range = |end: &mut usize, count| {
            *end += count;
            Some(*end - count..*end)
        };
        let ranges = counts.scan(0, range).collect();
        Self { shape, cells, affine, join, initializations, ranges }
    }

    /// What the network was made of.
    pub fn shape(&self) -> &NetworkShape {
        &self.shape
    }

    /// Size of a row of the batches it is evaluated on.
    pub fn row_size(&self) -> RowSize {
        let NetworkShape { observation, frames, extra_inputs, .. } = &self.shape;
        RowSize { observation_bytes: frames * observation.bytes(), extra_inputs: *extra_inputs }
    }

    /// Outputs of all heads.
    pub fn outputs(&self) -> usize {
        self.shape.heads.iter().map(|head| head.outputs).sum()
    }

    /// Length of the flat parameters.
    pub fn parameter_count(&self) -> usize {
        self.ranges.last().expect("there is an output layer").end
    }

    /// Where each layer's parameters lie, from the first layer to the last.
    pub fn parameter_ranges(&self) -> &[Range<usize>] {
        &self.ranges
    }

    /// Where the parameters of each affine layer lie; before them come those of the cells layer.
    fn affine_ranges(&self) -> &[Range<usize>] {
        &self.ranges[self.ranges.len() - self.affine.len()..]
    }

    /// Draws first parameters.
    pub fn initial_parameters(&self, stream: &mut Stream) -> Vec<f32> {
        let mut parameters = Vec::with_capacity(self.parameter_count());
        if let Some(cells) = &self.cells {
            let channels = cells.output[2];
            parameters.extend(Initialization::FanIn.draw(cells.fan_in(), channels, stream));
        }
        for (layer, initialization) in self.affine.iter().zip(&self.initializations) {
            parameters.extend(initialization.draw(layer.fan_in(), layer.fan_out(), stream));
        }
        let fan_in = self.affine.last().expect("there is an output layer").fan_in();
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
    /// If there are not [`Network::parameter_count`] of them.
    pub fn prepare(&self, parameters: &[f32]) -> Prepared {
        let mut prepared = Prepared::default();
        self.prepare_into(parameters, &mut prepared);
        prepared
    }

    /// Packs a version of the parameters into the memory of an earlier one.
    ///
    /// # Panics
    /// If there are not [`Network::parameter_count`] of them.
    pub fn prepare_into(&self, parameters: &[f32], prepared: &mut Prepared) {
        assert_eq!(parameters.len(), self.parameter_count(), "parameters of this network");
        if let Some(cells) = &self.cells {
            cells.prepare(&parameters[..cells.parameter_count()], &mut prepared.table);
        }
        prepared.panels.resize_with(self.affine.len(), Panels::default);
        let layers = self.affine.iter().zip(self.affine_ranges());
        for ((layer, range), panels) in layers.zip(&mut prepared.panels) {
            layer.prepare(&parameters[range.clone()], panels);
        }
    }

    /// Evaluates the network; the outputs are `outputs x rows`. A row's outputs depend on that row and
    /// the parameters only, bit for bit.
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
        workspace.values.resize_with(self.affine.len() + 1, || DMatrix::zeros(0, 0));
        self.encode(prepared, batch, rows, workspace);
        for (index, (layer, panels)) in self.affine.iter().zip(&prepared.panels).enumerate() {
            if index == self.join {
                widen(&mut workspace.values[index], batch.extra_inputs, rows);
            }
            let [input, output] = workspace
                .values
                .get_disjoint_mut([index, index + 1])
                .expect("there is one more than there are layers");
            reshape(output, layer.row_outputs(), rows);
            layer.forward(panels, input.as_slice(), output.as_mut_slice());
        }
        workspace.outputs()
    }

    /// Writes the input of the first affine layer.
    fn encode(
        &self,
        prepared: &Prepared,
        batch: Batch<'_>,
        rows: usize,
        workspace: &mut Workspace,
    ) {
        let Workspace { values, winners, .. } = workspace;
        let values = &mut values[0];
        if let Some(cells) = &self.cells {
            reshape(values, cells.row_outputs(), rows);
            winners.resize(rows * cells.row_outputs(), 0);
            cells.forward(&prepared.table, batch.observations, values.as_mut_slice(), winners);
        } else {
            reshape(values, self.affine[0].inputs - self.shape.extra_inputs, rows);
            let numbers = values.iter_mut().zip(floats(batch.observations));
            numbers.for_each(|(value, number)| *value = number);
        }
    }

    /// Adds to `gradient` the gradient of the parameters, for the gradient of the outputs of the last
    /// [`Network::forward`] in this workspace, which was on the same batch and parameters.
    ///
    /// # Panics
    /// If a shape is not that of the forward half.
    pub fn backward(
        &self,
        prepared: &Prepared,
        batch: Batch<'_>,
        workspace: &mut Workspace,
        output_gradient: &DMatrix<f32>,
        gradient: &mut [f32],
    ) {
        let Workspace { values, winners, vectors, output_gradients, input_gradients } = workspace;
        assert_eq!(gradient.len(), self.parameter_count(), "parameters of this network");
        assert_eq!(output_gradient.shape(), values[self.affine.len()].shape(), "outputs x rows");
        let rows = batch.rows(self.row_size());
        assert_eq!(rows, output_gradient.ncols(), "rows of the batch of the forward half");
        reshape(output_gradients, output_gradient.nrows(), rows);
        output_gradients.copy_from(output_gradient);
        for (index, (layer, range)) in
            self.affine.iter().zip(self.affine_ranges()).enumerate().rev()
        {
            layer
                .activation
                .backward(values[index + 1].as_slice(), output_gradients.as_mut_slice());
            if index + 1 == self.join {
                narrow(output_gradients, self.shape.extra_inputs, rows);
            }
            let own = &mut gradient[range.clone()];
            layer.parameter_gradient(
                values[index].as_slice(),
                output_gradients.as_slice(),
                vectors,
                own,
            );
            if index > 0 || self.cells.is_some() {
                reshape(input_gradients, layer.inputs, rows);
                let panels = &prepared.panels[index];
                layer.input_gradient(
                    panels,
                    output_gradients.as_slice(),
                    input_gradients.as_mut_slice(),
                );
                std::mem::swap(output_gradients, input_gradients);
            }
        }
        if let Some(cells) = &self.cells {
            Activation::Relu.backward(values[0].as_slice(), output_gradients.as_mut_slice());
            let own = &mut gradient[..cells.parameter_count()];
            cells.parameter_gradient(
                batch.observations,
                winners,
                output_gradients.as_slice(),
                vectors,
                own,
            );
        }
    }

    /// The gradient of the numbers each row consists of, for the gradient of the outputs of the last
    /// [`Network::forward`] in this workspace, which was with the same parameters: `numbers x rows`.
    /// They are those of the vectors and then those beside them; of a grid only those beside.
    /// [`Network::backward`] may come before it or after it.
    ///
    /// # Panics
    /// If a shape is not that of the forward half.
    pub fn input_gradient<'w>(
        &self,
        prepared: &Prepared,
        workspace: &'w mut Workspace,
        output_gradient: &DMatrix<f32>,
    ) -> &'w DMatrix<f32> {
        let Workspace { values, output_gradients, input_gradients, .. } = workspace;
        assert_eq!(output_gradient.shape(), values[self.affine.len()].shape(), "outputs x rows");
        let rows = output_gradient.ncols();
        reshape(output_gradients, output_gradient.nrows(), rows);
        output_gradients.copy_from(output_gradient);
        for (index, layer) in self.affine.iter().enumerate().skip(self.join).rev() {
            layer
                .activation
                .backward(values[index + 1].as_slice(), output_gradients.as_mut_slice());
            reshape(input_gradients, layer.inputs, rows);
            let panels = &prepared.panels[index];
            layer.input_gradient(
                panels,
                output_gradients.as_slice(),
                input_gradients.as_mut_slice(),
            );
            std::mem::swap(output_gradients, input_gradients);
        }
        if self.cells.is_some() {
            last(output_gradients, self.shape.extra_inputs, rows);
        }
        output_gradients
    }
}

/// Gives a matrix a new shape in the memory it has; its numbers are to be overwritten.
pub(crate) fn reshape(matrix: &mut DMatrix<f32>, features: usize, rows: usize) {
    if matrix.shape() != (features, rows) {
        let mut numbers: Vec<f32> = std::mem::replace(matrix, DMatrix::zeros(0, 0)).data.into();
        numbers.resize(features * rows, 0.0);
        *matrix = DMatrix::from_vec(features, rows, numbers);
    }
}

/// Appends each row's numbers of `beside` to its features.
fn widen(values: &mut DMatrix<f32>, extra_inputs: &[f32], rows: usize) {
    if extra_inputs.is_empty() {
        return;
    }
    let (features, further) = (values.nrows(), extra_inputs.len() / rows);
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
fn narrow(values: &mut DMatrix<f32>, further: usize, rows: usize) {
    if further == 0 {
        return;
    }
    let width = values.nrows();
    let features = width - further;
    let numbers = values.as_mut_slice();
    for row in 0..rows {
        numbers.copy_within(row * width..row * width + features, row * features);
    }
    reshape(values, features, rows);
}

/// Keeps only the last `further` features of each row.
fn last(values: &mut DMatrix<f32>, further: usize, rows: usize) {
    let width = values.nrows();
    let numbers = values.as_mut_slice();
    for row in 0..rows {
        numbers.copy_within((row + 1) * width - further..(row + 1) * width, row * further);
    }
    reshape(values, further, rows);
}
