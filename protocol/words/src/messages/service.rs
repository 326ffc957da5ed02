//! Requests to the proximity service, and its answers.

use bytes::Bytes;
use prost::Message;

use super::{RewardUpdate, Score};
use crate::trajectory::TrajectoryKey;

/// A request to the proximity service.
#[derive(Clone, PartialEq, Message)]
pub struct ServiceRequest {
    /// The request.
    #[prost(oneof = "Ask", tags = "1, 2, 3, 4, 5, 6")]
    pub ask: Option<Ask>,
}

/// The kinds of request.
#[derive(Clone, PartialEq, prost::Oneof)]
pub enum Ask {
    /// Restore the state after this many iterations; for 0, a fresh model trained offline. Comes before any batch.
    #[prost(message, tag = "1")]
    Begin(Begin),
    /// Make these trajectories the batch of an iteration, and report which of them are missing.
    #[prost(message, tag = "2")]
    Batch(BatchRequest),
    /// Score the trajectories of the current batch.
    #[prost(message, tag = "3")]
    Score(IterationRequest),
    /// Train on the current batch and the demonstrations (Eq. 4).
    #[prost(message, tag = "4")]
    Improve(IterationRequest),
    /// Write a checkpoint file.
    #[prost(message, tag = "5")]
    Save(Save),
    /// Estimate proximity and uncertainty of any observations. This changes nothing, and any process may ask.
    #[prost(message, tag = "6")]
    Query(Query),
}

/// See [`Ask::Begin`].
#[derive(Clone, PartialEq, Message)]
pub struct Begin {
    /// Number of finished iterations.
    #[prost(uint64, tag = "1")]
    pub iteration: u64,
    /// The service's file in the checkpoint to continue from; empty for a fresh start.
    #[prost(string, tag = "2")]
    pub checkpoint: String,
}

/// See [`Ask::Batch`].
#[derive(Clone, PartialEq, Message)]
pub struct BatchRequest {
    /// The iteration.
    #[prost(uint64, tag = "1")]
    pub iteration: u64,
    /// Its trajectories, in batch order.
    #[prost(message, repeated, tag = "2")]
    pub keys: Vec<TrajectoryKey>,
    /// Encoded trajectories that the service reported missing.
    #[prost(bytes = "bytes", repeated, tag = "3")]
    pub supplied: Vec<Bytes>,
}

/// A request about the current batch.
#[derive(Clone, Copy, PartialEq, Message)]
pub struct IterationRequest {
    /// The iteration.
    #[prost(uint64, tag = "1")]
    pub iteration: u64,
}

/// See [`Ask::Save`].
#[derive(Clone, PartialEq, Message)]
pub struct Save {
    /// File to write, in a folder that exists.
    #[prost(string, tag = "1")]
    pub path: String,
}

/// See [`Ask::Query`].
#[derive(Clone, PartialEq, Message)]
pub struct Query {
    /// Concatenated observations, each of the spec's length in bytes.
    #[prost(bytes = "bytes", tag = "1")]
    pub observations: Bytes,
}

/// The service's answer.
#[derive(Clone, PartialEq, Message)]
pub struct ServiceReply {
    /// The answer.
    #[prost(oneof = "Answer", tags = "1, 2, 3, 4, 5, 6, 7, 8")]
    pub answer: Option<Answer>,
}

/// The kinds of answer.
#[derive(Clone, PartialEq, prost::Oneof)]
pub enum Answer {
    /// Answer to `Begin` and `Improve`.
    #[prost(message, tag = "1")]
    Updated(RewardUpdate),
    /// Answer to `Batch`: what is missing; empty if the batch is complete.
    #[prost(message, tag = "2")]
    Missing(Missing),
    /// Answer to `Score`, in batch order.
    #[prost(message, tag = "3")]
    Scores(Scores),
    /// Answer to `Save`.
    #[prost(message, tag = "4")]
    Saved(Saved),
    /// Answer to `Query`.
    #[prost(message, tag = "5")]
    Estimates(Estimates),
    /// The reason why the request could not be served.
    #[prost(string, tag = "6")]
    Refused(String),
    /// The reason why the request cannot be served, now or later: `run::process::Final`.
    #[prost(string, tag = "7")]
    Final(String),
    /// Answer to `Begin` while offline training is under way. The request is to be repeated.
    #[prost(message, tag = "8")]
    Pretraining(Pretraining),
}

/// Progress of offline training.
#[derive(Clone, Copy, PartialEq, Eq, Message)]
pub struct Pretraining {
    /// Number of gradient steps done.
    #[prost(uint64, tag = "1")]
    pub done: u64,
    /// Number of gradient steps in total.
    #[prost(uint64, tag = "2")]
    pub total: u64,
}

/// See [`Answer::Missing`].
#[derive(Clone, PartialEq, Message)]
pub struct Missing {
    /// Positions of the missing trajectories in the batch.
    #[prost(uint32, repeated, tag = "1")]
    pub positions: Vec<u32>,
}

/// See [`Answer::Saved`].
#[derive(Clone, PartialEq, Message)]
pub struct Saved {
    /// SHA-256 of the weights written.
    #[prost(string, tag = "1")]
    pub weights_sha256: String,
    /// SHA-256 of the file.
    #[prost(string, tag = "2")]
    pub file_sha256: String,
}

/// See [`Answer::Scores`].
#[derive(Clone, PartialEq, Message)]
pub struct Scores {
    /// One score per trajectory.
    #[prost(message, repeated, tag = "1")]
    pub scores: Vec<Score>,
}

/// See [`Answer::Estimates`].
#[derive(Clone, PartialEq, Message)]
pub struct Estimates {
    /// Number of updates the model has had.
    #[prost(uint64, tag = "1")]
    pub model_version: u64,
    /// Proximity in [0, 1], one per observation.
    #[prost(float, repeated, tag = "2")]
    pub proximity: Vec<f32>,
    /// Standard deviation of the ensemble, one per observation.
    #[prost(float, repeated, tag = "3")]
    pub uncertainty: Vec<f32>,
}
