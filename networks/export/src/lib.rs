//! Exports trained networks for programs without Goalward: as ONNX models, whose inputs are raw observations, and
//! as safetensors.
//!
//! [`policy()`] exports the policy: normalization, network, distribution and action scale in one graph.
//! [`ensemble()`] exports a reward model: the mean and standard deviation of its members. Weights have PyTorch's
//! layout: `[output, input]` for dense layers and `[output, input, row, column]` for convolutions.
//!
//! | module | what it does |
//! |---|---|
//! | `graph` | encodes operators and weights as a file |
//! | `network` | turns a network into operators and weights |
//! | `policy`, `ensemble` | build the complete graphs around the networks |
//! | `message` | has the messages of the ONNX format |

mod ensemble;
mod graph;
mod message;
mod network;
mod policy;

pub use ensemble::ensemble;
pub use graph::Graph;
pub use policy::policy;
