//! Encoders turn observations into features; there is one for each kind of observation.

mod cells;

use std::ops::Range;

use nalgebra::DMatrix;
use protocol::encoder::CellsArchitecture;
use protocol::seed::Stream;
use protocol::task::{ObservationSpec, floats};

use crate::encoder::cells::{CellsEncoder, CellsMemory, CellsWindows};
use crate::layer::dense::Panels;
use crate::layer::kernel::Vector16;
use crate::layer::stack::GradientMemory;

/// Encoder of the observations of a row.
#[derive(Clone, Debug)]
pub(crate) enum Encoder {
    /// Identity: the numbers of vector observations are the features.
    Vector {
        /// Numbers per row.
        len: usize,
    },
    /// Convolutions and a dense layer over grids of cells.
    Cells(CellsEncoder),
}

/// One version of an encoder's parameters, packed for the kernels.
#[derive(Clone, Debug, Default)]
pub(crate) struct PreparedEncoder {
    table: Vec<Vector16>,
    panels: Vec<Panels>,
}

/// Memory of one thread for evaluating an encoder and for back-propagation.
#[derive(Clone, Debug, Default)]
pub(crate) struct EncoderMemory {
    cells: CellsMemory,
}

/// Distinct windows of observations; the memory is reused from one [`Indexed`] to the next.
#[derive(Clone, Debug, Default)]
pub struct WindowIndex {
    cells: CellsWindows,
}

/// Observations whose distinct windows are already known ([`crate::Network::index`]). Networks with the same
/// encoder can evaluate them repeatedly, as a whole or in part, without searching again.
#[derive(Clone, Copy, Debug)]
pub struct Indexed<'a> {
    pub(crate) bytes: &'a [u8],
    pub(crate) windows: &'a WindowIndex,
}

/// The observations of a batch, `frames` per row.
#[derive(Clone, Copy, Debug)]
pub enum Observations<'a> {
    /// Plain bytes of the observations.
    Bytes(&'a [u8]),
    /// All indexed observations.
    Indexed(Indexed<'a>),
    /// Some rows of indexed observations, given by their positions.
    Rows(Indexed<'a>, &'a [u32]),
}

impl Encoder {
    /// Creates the encoder for rows of `frames` observations.
    ///
    /// # Panics
    /// If a grid of cells is too small for the convolutions.
    pub(crate) fn new(
        observation: ObservationSpec,
        frames: usize,
        architecture: &CellsArchitecture,
    ) -> Self {
        match observation {
            ObservationSpec::Vector { len } => Encoder::Vector { len: frames * len },
            ObservationSpec::Cells { height, width, classes } => {
                let grid = [height, width];
                Encoder::Cells(CellsEncoder::new(grid, classes, frames, architecture))
            }
        }
    }

    /// Returns the number of features per row.
    pub(crate) fn features(&self) -> usize {
        match self {
            Encoder::Vector { len } => *len,
            Encoder::Cells(cells) => cells.features(),
        }
    }

    /// Returns whether the features are the observation's own numbers.
    pub(crate) fn is_identity(&self) -> bool {
        matches!(self, Encoder::Vector { .. })
    }

    /// Returns the range of each layer's parameters.
    pub(crate) fn parameter_ranges(&self) -> Vec<Range<usize>> {
        match self {
            Encoder::Vector { .. } => Vec::new(),
            Encoder::Cells(cells) => cells.parameter_ranges().to_vec(),
        }
    }

    /// Draws initial parameters.
    pub(crate) fn initial_parameters(&self, stream: &mut Stream) -> Vec<f32> {
        match self {
            Encoder::Vector { .. } => Vec::new(),
            Encoder::Cells(cells) => cells.initial_parameters(stream),
        }
    }

    /// Packs `parameters` for the kernels.
    pub(crate) fn prepare(&self, parameters: &[f32], prepared: &mut PreparedEncoder) {
        if let Encoder::Cells(cells) = self {
            cells.prepare(parameters, prepared);
        }
    }

    /// Finds the distinct windows of observations.
    pub(crate) fn index<'a>(
        &self,
        observations: &'a [u8],
        windows: &'a mut WindowIndex,
    ) -> Indexed<'a> {
        if let Encoder::Cells(cells) = self {
            cells.find_windows(observations, &mut windows.cells);
        }
        Indexed { bytes: observations, windows }
    }

    /// Writes the features of each row of observations to one column of `features`.
    ///
    /// # Panics
    /// If a cell's class is out of range.
    pub(crate) fn forward(
        &self,
        prepared: &PreparedEncoder,
        observations: Observations<'_>,
        memory: &mut EncoderMemory,
        features: &mut DMatrix<f32>,
    ) {
        match self {
            Encoder::Vector { len } => copy(observations, *len, features),
            Encoder::Cells(cells) => {
                cells.forward(prepared, observations, &mut memory.cells, features);
            }
        }
    }

    /// Adds the gradient of the parameters to `gradient`, given the gradient of the features in `gradients`.
    pub(crate) fn backward(
        &self,
        prepared: &PreparedEncoder,
        observations: Observations<'_>,
        memory: &mut EncoderMemory,
        gradients: &mut GradientMemory,
        gradient: &mut [f32],
    ) {
        if let Encoder::Cells(cells) = self {
            let GradientMemory { outputs, vectors, .. } = gradients;
            let memory = &mut memory.cells;
            cells.backward(prepared, observations, memory, outputs, vectors, gradient);
        }
    }
}

/// Copies the numbers of vector observations, `len` per row.
fn copy(observations: Observations<'_>, len: usize, features: &mut DMatrix<f32>) {
    let copy = |features: &mut [f32], bytes: &[u8]| {
        features.iter_mut().zip(floats(bytes)).for_each(|(feature, number)| *feature = number);
    };
    let features = features.as_mut_slice();
    match observations {
        Observations::Bytes(bytes) | Observations::Indexed(Indexed { bytes, .. }) => {
            copy(features, bytes);
        }
        Observations::Rows(Indexed { bytes, .. }, rows) => {
            let row_bytes = len * size_of::<f32>();
            for (features, &row) in features.chunks_exact_mut(len).zip(rows) {
                copy(features, &bytes[row as usize * row_bytes..][..row_bytes]);
            }
        }
    }
}
