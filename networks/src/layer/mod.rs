//! The layers a network is made of, each with its forward and its backward half.
//!
//! A layer knows shapes only. It reads its own stretch of the flat parameters, packed once per
//! version for the kernel, and adds to the same stretch of the flat gradient.
pub(crate) mod activation;
pub(crate) mod affine;
pub(crate) mod cells;
pub(crate) mod kernel;
