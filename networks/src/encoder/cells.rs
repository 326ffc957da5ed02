//! The encoder of grids of cells (Appendix G.2): convolutions, the first of them pooled, and a dense
//! layer, each with a rectifier.

use std::ops::Range;

use nalgebra::DMatrix;
use protocol::encoder::CellsArchitecture;
use protocol::seed::Stream;

use super::PreparedEncoder;
use crate::initialization::Initialization;
use crate::layer::activation::Activation;
use crate::layer::affine::Affine;
use crate::layer::cells::Cells;
use crate::layer::reshape;
use crate::layer::stack::{GradientMemory, Stack};

/// The layers of the encoder.
#[derive(Clone, Debug)]
pub(crate) struct CellsEncoder {
    first: Cells,
    further: Stack,
}

/// What a thread needs to evaluate it, and to take gradients back through it.
#[derive(Clone, Debug, Default)]
pub(crate) struct CellsMemory {
    /// The input of every affine layer, and the features.
    values: Vec<DMatrix<f32>>,
    winners: Vec<u8>,
}

impl CellsEncoder {
    /// The encoder of `frames` grids of `[height, width]` a row.
    ///
    /// # Panics
    /// If there is no convolution, or the grid is too small for them.
    pub(crate) fn new(
        [height, width]: [usize; 2],
        classes: usize,
        frames: usize,
        architecture: &CellsArchitecture,
    ) -> Self {
        let CellsArchitecture { channels, kernel, pool, features } = architecture;
        let (&first, further) = channels.split_first().expect("an encoder has a convolution");
        let first = Cells::new(frames, [height, width], classes, *kernel, *pool, first);
        let mut image = first.output;
        let mut layers = Vec::new();
        for &channels in further {
            layers.push(Affine::convolution(image, *kernel, channels, Activation::Relu));
            image = [image[0] + 1 - kernel, image[1] + 1 - kernel, channels];
        }
        layers.push(Affine::dense(image.iter().product(), *features, Activation::Relu));
        Self { first, further: Stack::new(layers) }
    }

    pub(super) fn features(&self) -> usize {
        self.further.layers().last().expect("a dense layer ends the encoder").row_outputs()
    }

    pub(super) fn parameter_ranges(&self) -> Vec<Range<usize>> {
        let start = self.first.parameter_count();
        let further = self.further.ranges().iter();
        let further = further.map(|range| start + range.start..start + range.end);
        std::iter::once(0..start).chain(further).collect()
    }

    pub(super) fn initial_parameters(&self, stream: &mut Stream) -> Vec<f32> {
        let first = (self.first.fan_in(), self.first.output[2]);
        let further = self.further.layers().iter().map(|layer| (layer.fan_in(), layer.fan_out()));
        let layers = std::iter::once(first).chain(further);
        layers
            .flat_map(|(fan_in, outputs)| Initialization::FanIn.draw(fan_in, outputs, stream))
            .collect()
    }

    pub(super) fn prepare(&self, parameters: &[f32], prepared: &mut PreparedEncoder) {
        let (first, further) = parameters.split_at(self.first.parameter_count());
        self.first.prepare(first, &mut prepared.table);
        self.further.prepare(further, &mut prepared.panels);
    }

    pub(super) fn forward(
        &self,
        prepared: &PreparedEncoder,
        observations: &[u8],
        memory: &mut CellsMemory,
        features: &mut DMatrix<f32>,
    ) {
        let CellsMemory { values, winners } = memory;
        let input = self.further.input(values);
        reshape(input, self.first.row_outputs(), features.ncols());
        winners.resize(input.len(), 0);
        self.first.forward(&prepared.table, observations, input.as_mut_slice(), winners);
        self.further.forward(&prepared.panels, values);
        features.copy_from(values.last().expect("the input of a layer and its output"));
    }

    pub(super) fn backward(
        &self,
        prepared: &PreparedEncoder,
        observations: &[u8],
        memory: &CellsMemory,
        gradients: &mut GradientMemory,
        gradient: &mut [f32],
    ) {
        let CellsMemory { values, winners } = memory;
        let (first, further) = gradient.split_at_mut(self.first.parameter_count());
        self.further.backward(&prepared.panels, values, gradients, further, true);
        let GradientMemory { outputs, vectors, .. } = gradients;
        Activation::Relu.backward(values[0].as_slice(), outputs.as_mut_slice());
        self.first.parameter_gradient(observations, winners, outputs.as_slice(), vectors, first);
    }
}
