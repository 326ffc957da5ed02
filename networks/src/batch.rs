//! Batches of rows, as networks read them.

use std::ops::Range;

use crate::encoder::{Indexed, Observations};

/// Size of a row of a [`Batch`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RowSize {
    /// Bytes of the row's observations.
    pub observation_bytes: usize,
    /// Number of extra inputs.
    pub extra_inputs: usize,
}

/// Rows that a network is evaluated on, one after another.
#[derive(Clone, Copy, Debug)]
pub struct Batch<'a> {
    /// Observations of the rows.
    pub observations: Observations<'a>,
    /// Extra inputs of each row, which follow its observations; empty if the network takes none.
    pub extra_inputs: &'a [f32],
}

impl<'a> Batch<'a> {
    /// Creates a batch of observations without extra inputs.
    pub fn new(observations: &'a [u8]) -> Self {
        Self { observations: Observations::Bytes(observations), extra_inputs: &[] }
    }

    /// Returns the number of rows.
    ///
    /// # Panics
    /// If the batch does not consist of whole rows of this size.
    pub fn rows(&self, size: RowSize) -> usize {
        let RowSize { observation_bytes, extra_inputs } = size;
        let rows = match self.observations {
            Observations::Bytes(bytes) | Observations::Indexed(Indexed { bytes, .. }) => {
                let rows = bytes.len() / observation_bytes;
                assert_eq!(bytes.len(), rows * observation_bytes, "bytes of whole rows");
                rows
            }
            Observations::Rows(_, rows) => rows.len(),
        };
        assert_eq!(self.extra_inputs.len(), rows * extra_inputs, "extra inputs of whole rows");
        rows
    }

    /// Returns a range of the rows.
    pub(crate) fn slice(self, rows: Range<usize>, size: RowSize) -> Batch<'a> {
        let part = |width: usize| rows.start * width..rows.end * width;
        let observations = match self.observations {
            Observations::Bytes(bytes) => Observations::Bytes(&bytes[part(size.observation_bytes)]),
            Observations::Rows(indexed, all) => Observations::Rows(indexed, &all[rows.clone()]),
            Observations::Indexed(_) if rows == (0..self.rows(size)) => self.observations,
            Observations::Indexed(indexed) => {
                Observations::Bytes(&indexed.bytes[part(size.observation_bytes)])
            }
        };
        Batch { observations, extra_inputs: &self.extra_inputs[part(size.extra_inputs)] }
    }
}
