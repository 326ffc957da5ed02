//! Trained networks for programs that know nothing of Goalward: as ONNX models, whose rows are raw
//! observations, and as safetensors.
//!
//! [`policy()`] is the policy: normalization, network, distribution and action scale in one graph.
//! [`ensemble()`] is a reward model: the mean of its members and their standard deviation. Weights of dense
//! layers lie `[output, input]` and of convolutions `[output, input, row, column]`, as PyTorch has them.
//!
//! | module | what it does |
//! |---|---|
//! | `graph` | operators and weights become a file |
//! | `network` | a network of ours becomes operators and weights |
//! | `policy`, `ensemble` | what surrounds the networks |
//! | `message` | the messages of the ONNX format |

mod ensemble;
mod graph;
mod message;
mod network;
mod policy;

pub use ensemble::ensemble;
pub use graph::Graph;
pub use policy::policy;
