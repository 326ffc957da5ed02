//! What the proximity service is asked, and what it answers.

use bytes::Bytes;
use prost::Message;

use super::{RewardUpdate, Score};
use crate::trajectory::TrajectoryKey;

/// A request to the proximity service.
#[derive(Clone, PartialEq, Message)]
pub struct ServiceRequest {
    /// What is asked.
    #[prost(oneof = "Ask", tags = "1, 2, 3, 4, 5, 6")]
    pub ask: Option<Ask>,
}

/// The kinds of request.
#[derive(Clone, PartialEq, prost::Oneof)]
pub enum Ask {
    /// Be at the state after this many iterations: a fresh, pre-trained model for 0.
    #[prost(message, tag = "1")]
    Begin(Begin),
    /// These trajectories are the batch of an iteration; which of them are missing?
    #[prost(message, tag = "2")]
    Batch(Batch),
    /// Score the trajectories of the current batch.
    #[prost(message, tag = "3")]
    Score(IterationRequest),
    /// Train on the current batch and the demonstrations (Eq. 4).
    #[prost(message, tag = "4")]
    Improve(IterationRequest),
    /// Write a checkpoint file.
    #[prost(message, tag = "5")]
    Save(Save),
    /// Proximity and uncertainty of any observations. Changes nothing; any process may ask.
    #[prost(message, tag = "6")]
    Query(Query),
}

/// See [`Ask::Begin`].
#[derive(Clone, PartialEq, Message)]
pub struct Begin {
    /// Iterations finished.
    #[prost(uint64, tag = "1")]
    pub iteration: u64,
    /// The service's file of the checkpoint to continue from; empty for a fresh start.
    #[prost(string, tag = "2")]
    pub checkpoint: String,
}

/// See [`Ask::Batch`].
#[derive(Clone, PartialEq, Message)]
pub struct Batch {
    /// The iteration.
    #[prost(uint64, tag = "1")]
    pub iteration: u64,
    /// Its trajectories, in batch order.
    #[prost(message, repeated, tag = "2")]
    pub keys: Vec<TrajectoryKey>,
    /// Encoded trajectories that the service said it lacks.
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
    /// Observations, one after another, each of the spec's length in bytes.
    #[prost(bytes = "bytes", tag = "1")]
    pub observations: Bytes,
}

/// The service's answer.
#[derive(Clone, PartialEq, Message)]
pub struct ServiceReply {
    /// What is answered.
    #[prost(oneof = "Answer", tags = "1, 2, 3, 4, 5, 6, 7, 8")]
    pub answer: Option<Answer>,
}

/// The kinds of answer.
#[derive(Clone, PartialEq, prost::Oneof)]
pub enum Answer {
    /// To `Begin` and `Improve`.
    #[prost(message, tag = "1")]
    Updated(RewardUpdate),
    /// To `Batch`: what it lacks; empty when the batch is complete.
    #[prost(message, tag = "2")]
    Missing(Missing),
    /// To `Score`, in batch order.
    #[prost(message, tag = "3")]
    Scores(Scores),
    /// To `Save`.
    #[prost(message, tag = "4")]
    Saved(Saved),
    /// To `Query`.
    #[prost(message, tag = "5")]
    Estimates(Estimates),
    /// The request could not be served, and why.
    #[prost(string, tag = "6")]
    Refused(String),
    /// The same, and it never could: `run::process::Final`.
    #[prost(string, tag = "7")]
    Final(String),
    /// To `Begin`, which is to be asked again: offline training is under way.
    #[prost(message, tag = "8")]
    Pretraining(Pretraining),
}

/// How far offline training has come.
#[derive(Clone, Copy, PartialEq, Eq, Message)]
pub struct Pretraining {
    /// Gradient steps done,
    #[prost(uint64, tag = "1")]
    pub done: u64,
    /// of so many.
    #[prost(uint64, tag = "2")]
    pub total: u64,
}

/// See [`Answer::Missing`].
#[derive(Clone, PartialEq, Message)]
pub struct Missing {
    /// Positions in the batch.
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
    /// Updates the model has had.
    #[prost(uint64, tag = "1")]
    pub model_version: u64,
    /// One per observation, in [0, 1].
    #[prost(float, repeated, tag = "2")]
    pub proximity: Vec<f32>,
    /// One per observation, standard deviation of the ensemble.
    #[prost(float, repeated, tag = "3")]
    pub uncertainty: Vec<f32>,
}
