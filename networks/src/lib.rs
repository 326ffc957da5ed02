//! The small neural networks of the paper (Appendix G.2), their losses and their optimizer, with
//! explicit back-propagation.
//!
//! Inputs are observation bytes in the environments' layout, vectors normalized by the caller. Outputs are action
//! parameters, values and proximities, as `features x rows` matrices, so that a row of a batch is one contiguous
//! column. All parameters of a network are one flat slice. This slice is optimized, clipped, hashed, published and
//! checkpointed; the network itself holds only shapes.
//!
//! The crate uses no clock and no files. Its only randomness is the stream passed in, and only [`ShardedTrainer`]
//! and [`evaluate`] use threads. Every sum has a fixed order, so the bits of a row never depend on neighboring
//! rows, and the bits of a gradient never depend on the thread that computed it.
//!
//! | module | what it does |
//! |---|---|
//! | `network`, `shape` | a network and its shape: encoder, hidden layers, heads |
//! | `encoder`, `layer` | observations to features; the layers, each with its forward and backward pass |
//! | `policy`, `ensemble` | actor and critic; the members of a reward model |
//! | `distribution` | a policy's outputs to actions and log-probabilities, and back to gradients |
//! | `loss`, `optimizer`, `initialization` | losses; gradient clipping and Adam; initial weights |
//! | `normalization` | moments of observations and returns |
//! | `batch`, `training` | rows of observations; evaluation and gradient steps on several threads |

mod batch;
mod distribution;
mod encoder;
mod ensemble;
mod initialization;
mod layer;
mod loss;
mod network;
mod normalization;
mod optimizer;
mod policy;
mod shape;
mod training;

pub use batch::{Batch, RowSize};
pub use distribution::Distribution;
pub use encoder::{Indexed, Observations, WindowIndex};
pub use ensemble::{Ensemble, PreparedEnsemble, RowScore, Squashing};
pub use initialization::Initialization;
pub use layer::activation::Activation;
pub use loss::{binary_cross_entropy, log_sum_exp, ranking, sigmoid, softplus, squared_error};
pub use network::{Network, Prepared, Workspace};
pub use normalization::{RunningMoments, RunningNormalizer};
pub use optimizer::{Adam, clip_global_norm};
pub use policy::{ActorCritic, Evaluation, PolicyWorkspace, PreparedPolicy};
pub use shape::{Head, NetworkShape, PolicyArchitecture, RewardArchitecture};
pub use training::{Shard, ShardedTrainer, Step, Trainable, evaluate};
