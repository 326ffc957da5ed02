//! Batches of rows, as networks read them.

use std::ops::Range;

/// Size of a row of a [`Batch`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RowSize {
    /// Bytes of its observations.
    pub observation_bytes: usize,
    /// Numbers that join them.
    pub extra_inputs: usize,
}

/// What a network is evaluated on: rows one after another.
#[derive(Clone, Copy, Debug)]
pub struct Batch<'a> {
    /// Observations as their bytes, `frames` to a row.
    pub observations: &'a [u8],
    /// Each row's numbers that join the observations; empty if the network takes none.
    pub extra_inputs: &'a [f32],
}

impl<'a> Batch<'a> {
    /// Rows of observations without extra inputs.
    pub fn new(observations: &'a [u8]) -> Self {
        Self { observations, extra_inputs: &[] }
    }

    /// How many rows there are.
    ///
    /// # Panics
    /// If they are not whole rows of this size.
    pub fn rows(&self, size: RowSize) -> usize {
        let RowSize { observation_bytes, extra_inputs } = size;
        let rows = self.observations.len() / observation_bytes;
        assert_eq!(self.observations.len(), rows * observation_bytes, "bytes of whole rows");
        assert_eq!(self.extra_inputs.len(), rows * extra_inputs, "extra inputs of whole rows");
        rows
    }

    /// Some of the rows.
    pub(crate) fn slice(self, rows: Range<usize>, size: RowSize) -> Batch<'a> {
        let part = |width: usize| rows.start * width..rows.end * width;
        Batch {
            observations: &self.observations[part(size.observation_bytes)],
            extra_inputs: &self.extra_inputs[part(size.extra_inputs)],
        }
    }
}
