//! The small neural networks of the paper (Appendix G.2), their losses and their optimizer, with
//! explicit back-propagation.
//!
//! Observation bytes come in as the environments wrote them; action parameters, values and
//! proximities go out as `features x rows` matrices, so that a row of a batch is one contiguous
//! column. All parameters of a network are one flat slice: what is optimized, clipped, hashed,
//! published and checkpointed is that slice, and a network itself holds only shapes.
//!
//! There is no clock, no file and no randomness here but the stream handed in, and threads in
//! [`ShardedTrainer`] and [`evaluate`] alone. Every sum has one fixed order, so the bits of a row never
//! depend on the rows next to it, and the bits of a gradient never depend on who computed it.
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
pub use ensemble::{Ensemble, PreparedEnsemble, Score, Squashing};
pub use initialization::Initialization;
pub use layer::activation::Activation;
pub use loss::{binary_cross_entropy, ranking, sigmoid, softplus, squared_error};
pub use network::{Network, Prepared, Workspace};
pub use normalization::{RunningMoments, RunningNormalizer};
pub use optimizer::{Adam, clip_global_norm};
pub use policy::{ActorCritic, Evaluation, PolicyWorkspace, PreparedPolicy};
pub use shape::{Head, NetworkShape, PolicyArchitecture, RewardArchitecture};
pub use training::{Shard, ShardedTrainer, Step, Trainable, evaluate};
