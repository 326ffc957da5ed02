//! The layers a network is made of, each with its forward and its backward half.
//!
//! A layer knows shapes only. It reads its own stretch of the flat parameters, packed once per
//! version for the kernel, and adds to the same stretch of the flat gradient.

pub(crate) mod activation;
pub(crate) mod cells;
pub(crate) mod dense;
pub(crate) mod distinct;
pub(crate) mod kernel;
pub(crate) mod stack;
pub(crate) mod windows;

use std::ops::Range;

use nalgebra::DMatrix;

/// Where the parameters of layers lie that have so many, one behind another.
pub(crate) fn ranges(counts: impl Iterator<Item = usize>) -> Vec<Range<usize>> {
    counts
        .scan(0, |end, count| {
            *end += count;
            Some(*end - count..*end)
        })
        .collect()
}

/// Gives a matrix a new shape in the memory it has; its numbers are to be overwritten.
pub(crate) fn reshape(matrix: &mut DMatrix<f32>, features: usize, rows: usize) {
    if matrix.shape() != (features, rows) {
        let mut numbers: Vec<f32> = std::mem::replace(matrix, DMatrix::zeros(0, 0)).data.into();
        numbers.resize(features * rows, 0.0);
        *matrix = DMatrix::from_vec(features, rows, numbers);
    }
}
