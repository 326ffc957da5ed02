//! The layers of a network, each with its forward and backward pass.
//!
//! A layer knows only shapes. It reads its own range of the flat parameters, which is packed for the kernel once
//! per version, and adds to the same range of the flat gradient.

pub(crate) mod activation;
pub(crate) mod cells;
pub(crate) mod dense;
pub(crate) mod distinct;
pub(crate) mod kernel;
pub(crate) mod stack;
pub(crate) mod windows;

use std::ops::Range;

use nalgebra::DMatrix;

/// Returns the ranges of the parameters of consecutive layers, given the number of parameters of each.
pub(crate) fn ranges(counts: impl Iterator<Item = usize>) -> Vec<Range<usize>> {
    counts
        .scan(0, |end, count| {
            *end += count;
            Some(*end - count..*end)
        })
        .collect()
}

/// Changes the shape of a matrix in its own memory. The numbers keep their order in memory; those added are zero.
pub(crate) fn reshape(matrix: &mut DMatrix<f32>, features: usize, rows: usize) {
    if matrix.shape() != (features, rows) {
        let mut numbers: Vec<f32> = std::mem::replace(matrix, DMatrix::zeros(0, 0)).data.into();
        numbers.resize(features * rows, 0.0);
        *matrix = DMatrix::from_vec(features, rows, numbers);
    }
}
