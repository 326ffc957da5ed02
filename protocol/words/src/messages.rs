//! What the processes ask and tell each other, besides trajectories.
//!
//! Recorded: [`Score`], [`PolicyUpdate`], [`RewardUpdate`], [`Checkpoint`] (schema in
//! `schema/goalward.proto`). Only on the bus: leases, weights, requests to the proximity service.

use bytes::Bytes;
use prost::Message;

use crate::trajectory::TrajectoryKey;

/// An actor asks for leases and hands back those it has finished.
#[derive(Clone, PartialEq, Message)]
pub struct LeaseRequest {
    /// The actor's name on the bus.
    #[prost(string, tag = "1")]
    pub actor: String,
    /// Most leases it can take now.
    #[prost(uint32, tag = "2")]
    pub capacity: u32,
    /// Leases whose every trajectory it has published since it last asked.
    #[prost(message, repeated, tag = "3")]
    pub finished: Vec<Lease>,
    /// Where its time went since it last asked.
    #[prost(message, optional, tag = "4")]
    pub seconds: Option<ActorSeconds>,
}

/// Where actors' time went, seconds, waiting left out.
#[derive(Clone, Copy, PartialEq, Message)]
pub struct ActorSeconds {
    /// In environments.
    #[prost(double, tag = "1")]
    pub environment: f64,
    /// In the policy's network and in drawing actions.
    #[prost(double, tag = "2")]
    pub inference: f64,
    /// Encoding and publishing trajectories.
    #[prost(double, tag = "3")]
    pub transport: f64,
}

impl ActorSeconds {
    /// Whether time can have gone so.
    pub fn is_possible(&self) -> bool {
        let parts = [self.environment, self.inference, self.transport];
        parts.iter().all(|seconds| seconds.is_finite() && *seconds >= 0.0)
    }
}

/// The learner's answer; empty when every lane of the iteration is taken.
#[derive(Clone, PartialEq, Message)]
pub struct LeaseReply {
    /// The leases granted.
    #[prost(message, repeated, tag = "1")]
    pub leases: Vec<Lease>,
    /// The run is over: the actor ends.
    #[prost(bool, tag = "2")]
    pub finished: bool,
}

/// The right to run a lane's episodes for one iteration. What comes out depends on nothing else.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Message)]
pub struct Lease {
    /// Training or evaluation.
    #[prost(enumeration = "crate::trajectory::Source", tag = "1")]
    pub source: i32,
    /// Iteration the episodes belong to.
    #[prost(uint64, tag = "2")]
    pub iteration: u64,
    /// Environment stream.
    #[prost(uint64, tag = "3")]
    pub lane: u64,
    /// Policy that acts.
    #[prost(uint64, tag = "4")]
    pub policy_version: u64,
    /// First episode to run.
    #[prost(uint64, tag = "5")]
    pub first_episode: u64,
    /// Episodes are run until they have at least this many steps together,
    #[prost(uint64, tag = "6")]
    pub steps_owed: u64,
    /// and are at least this many.
    #[prost(uint64, tag = "7")]
    pub episodes_owed: u64,
}

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

/// What the reward model said of one trajectory.
#[derive(Clone, PartialEq, Message)]
pub struct Score {
    /// Iteration of the trajectory.
    #[prost(uint64, tag = "1")]
    pub iteration: u64,
    /// Lane of the trajectory.
    #[prost(uint64, tag = "2")]
    pub lane: u64,
    /// Episode of the trajectory.
    #[prost(uint64, tag = "3")]
    pub episode: u64,
    /// Updates the reward model had when it answered.
    #[prost(uint64, tag = "4")]
    pub model_version: u64,
    /// One per step (Eq. 5).
    #[prost(float, repeated, tag = "5")]
    pub rewards: Vec<f32>,
    /// One per observation, in [0, 1]; of a model that sees transitions or actions one per step.
    #[prost(float, repeated, tag = "6")]
    pub proximity: Vec<f32>,
    /// As many, standard deviations of the ensemble.
    #[prost(float, repeated, tag = "7")]
    pub uncertainty: Vec<f32>,
}

/// One policy update, after which `policy_version` acts.
#[derive(Clone, PartialEq, Message)]
pub struct PolicyUpdate {
    /// The iteration, from 0.
    #[prost(uint64, tag = "1")]
    pub iteration: u64,
    /// Updates the policy has had, this one included.
    #[prost(uint64, tag = "2")]
    pub policy_version: u64,
    /// Environment steps taken so far, this iteration included.
    #[prost(uint64, tag = "3")]
    pub environment_steps: u64,
    /// Training episodes finished so far.
    #[prost(uint64, tag = "4")]
    pub episodes: u64,
    /// The batch, in order.
    #[prost(message, repeated, tag = "5")]
    pub consumed: Vec<TrajectoryKey>,
    /// Major number of the minibatch stream.
    #[prost(uint64, tag = "6")]
    pub minibatch_seed: u64,
    /// Learning rate of the update.
    #[prost(double, tag = "7")]
    pub learning_rate: f64,
    /// Clipped surrogate loss, mean over the minibatches.
    #[prost(double, tag = "8")]
    pub policy_loss: f64,
    /// Clipped value loss.
    #[prost(double, tag = "9")]
    pub value_loss: f64,
    /// Entropy of the policy, nats.
    #[prost(double, tag = "10")]
    pub entropy: f64,
    /// Mean of `(ratio - 1) - ln ratio`, nats.
    #[prost(double, tag = "11")]
    pub approximate_kl: f64,
    /// Share of samples outside the clip range.
    #[prost(double, tag = "12")]
    pub clip_fraction: f64,
    /// Norm of the gradient before clipping.
    #[prost(double, tag = "13")]
    pub gradient_norm: f64,
    /// Of the last 100 training episodes.
    #[prost(double, tag = "14")]
    pub success_rate: f64,
    /// Per step, as scored.
    #[prost(double, tag = "15")]
    pub mean_reward: f64,
    /// Over the batch's observations.
    #[prost(double, tag = "16")]
    pub mean_proximity: f64,
    /// Over the batch's observations.
    #[prost(double, tag = "17")]
    pub mean_uncertainty: f64,
    /// Over the batch's episodes.
    #[prost(double, tag = "18")]
    pub mean_episode_steps: f64,
    /// Of the policy's weights after the update.
    #[prost(string, tag = "19")]
    pub weights_sha256: String,
    /// Wall time of the rollout.
    #[prost(double, tag = "20")]
    pub rollout_s: f64,
    /// Wall time of scoring.
    #[prost(double, tag = "21")]
    pub scoring_s: f64,
    /// Wall time of the update.
    #[prost(double, tag = "22")]
    pub update_s: f64,
    /// Loss on demonstrations held out; of learners that hold some out.
    #[prost(double, tag = "23")]
    pub held_out_loss: f64,
}

/// One update of the reward model.
#[derive(Clone, PartialEq, Message)]
pub struct RewardUpdate {
    /// The iteration; offline training has the number of its first one.
    #[prost(uint64, tag = "1")]
    pub iteration: u64,
    /// Updates the model has had, this one included.
    #[prost(uint64, tag = "2")]
    pub model_version: u64,
    /// Optimizer steps of this update.
    #[prost(uint64, tag = "3")]
    pub gradient_steps: u64,
    /// First term of Eq. 4.
    #[prost(double, tag = "4")]
    pub demonstration_loss: f64,
    /// Second term of Eq. 4.
    #[prost(double, tag = "5")]
    pub agent_loss: f64,
    /// Of all members' weights after the update.
    #[prost(string, tag = "6")]
    pub weights_sha256: String,
    /// Agent observations held.
    #[prost(uint64, tag = "7")]
    pub experience: u64,
    /// Wall time of the update.
    #[prost(double, tag = "8")]
    pub seconds: f64,
}

/// A checkpoint of learner and proximity service, taken together.
#[derive(Clone, PartialEq, Message)]
pub struct Checkpoint {
    /// Iterations finished.
    #[prost(uint64, tag = "1")]
    pub iteration: u64,
    /// The checkpoint's folder, relative to the run.
    #[prost(string, tag = "2")]
    pub path: String,
    /// Of the policy's weights.
    #[prost(string, tag = "3")]
    pub policy_sha256: String,
    /// Of the reward model's weights.
    #[prost(string, tag = "4")]
    pub proximity_sha256: String,
    /// Of the policy's file, as are the next two of theirs; empty in logs of older builds.
    #[prost(string, tag = "5")]
    pub policy_file_sha256: String,
    /// Of the learner's file.
    #[prost(string, tag = "6")]
    pub learner_file_sha256: String,
    /// Of the proximity service's file.
    #[prost(string, tag = "7")]
    pub proximity_file_sha256: String,
}

/// How a run stands; published by the learner, never waited for.
#[derive(Clone, PartialEq, Message)]
pub struct Progress {
    /// What the learner is doing.
    #[prost(enumeration = "Phase", tag = "1")]
    pub phase: i32,
    /// The newest policy update, if there is one.
    #[prost(message, optional, tag = "2")]
    pub update: Option<PolicyUpdate>,
    /// The newest update of the reward model.
    #[prost(message, optional, tag = "3")]
    pub reward_update: Option<RewardUpdate>,
    /// Environment steps the run is to take.
    #[prost(uint64, tag = "4")]
    pub steps_wanted: u64,
    /// Environment steps received, those of the unfinished rollout included.
    #[prost(uint64, tag = "5")]
    pub steps_received: u64,
    /// Actors on the bus.
    #[prost(uint32, tag = "6")]
    pub actors: u32,
    /// Leases handed out and unfinished.
    #[prost(uint32, tag = "7")]
    pub leases: u32,
    /// Versions between the newest policy and the one that acts.
    #[prost(uint32, tag = "8")]
    pub lag: u32,
    /// Training wall time, with earlier sittings of a resumed run.
    #[prost(double, tag = "9")]
    pub wall_s: f64,
    /// Bytes of the log so far.
    #[prost(uint64, tag = "10")]
    pub log_bytes: u64,
    /// Offline training, while it is under way.
    #[prost(message, optional, tag = "11")]
    pub pretraining: Option<Pretraining>,
    /// Actors that the learner has heard of, by name.
    #[prost(message, repeated, tag = "12")]
    pub actors_heard: Vec<ActorHeard>,
}

/// What the learner knows of an actor.
#[derive(Clone, PartialEq, Message)]
pub struct ActorHeard {
    /// Its name on the bus.
    #[prost(string, tag = "1")]
    pub name: String,
    /// Leases it holds and has not finished.
    #[prost(uint32, tag = "2")]
    pub leases: u32,
    /// Seconds since its last question or trajectory.
    #[prost(double, tag = "3")]
    pub ago_s: f64,
}

/// What a run is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, prost::Enumeration)]
#[repr(i32)]
pub enum Phase {
    /// Waiting for the proximity service to train offline.
    Pretraining = 0,
    /// Rolling out, scoring, updating.
    Training = 1,
    /// Running evaluation episodes.
    Evaluating = 2,
    /// Over.
    Finished = 3,
    /// Waiting for room on the disk.
    DiskFull = 4,
}
