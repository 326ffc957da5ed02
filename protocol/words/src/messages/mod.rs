//! What the processes ask and tell each other, besides trajectories.
//!
//! Recorded: [`Score`], [`PolicyUpdate`], [`RewardUpdate`], [`Checkpoint`] (schema in
//! `schema/goalward.proto`). Only on the bus: leases, weights, requests to the proximity service, and
//! how a run stands. Through a pipe: episodes to be audited.

mod audit;
mod leases;
mod service;

use prost::Message;

use crate::trajectory::TrajectoryKey;

pub use audit::AuditRequest;
pub use leases::{ActorSeconds, Lease, LeaseReply, LeaseRequest};
pub use service::{
    Answer, Ask, Batch, Begin, Estimates, IterationRequest, Missing, Pretraining, Query, Save,
    Saved, Scores, ServiceReply, ServiceRequest,
};

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
    /// One per observation, in [0, 1]; of transitions, and of discriminators that see actions, one per
    /// step; empty of a model that estimates nothing.
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
    /// Major number of the minibatch stream: the iteration.
    #[prost(uint64, tag = "6")]
    pub minibatch_seed: u64,
    /// Learning rate of the update.
    #[prost(double, tag = "7")]
    pub learning_rate: f64,
    /// Loss of the policy, mean over the minibatches: PPO's clipped surrogate, the mean negative
    /// log-likelihood of actions, or that of a soft actor-critic.
    #[prost(double, tag = "8")]
    pub policy_loss: f64,
    /// Loss of values, or of Q-functions.
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
    /// Wall time of training so far, offline training and earlier sittings included.
    #[prost(double, tag = "24")]
    pub wall_s: f64,
    /// Processor time of all processes of the run in that time.
    #[prost(double, tag = "25")]
    pub processor_s: f64,
}

/// One update of the reward model; the first is its offline training.
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
    /// Second term of Eq. 4, times `reward.agent_weight`.
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
    /// Processor time of the proximity service since its update before.
    #[prost(double, tag = "9")]
    pub processor_s: f64,
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

impl Progress {
    /// Environment steps learned from; before the first update of a sitting those received.
    pub fn environment_steps(&self) -> u64 {
        self.update.as_ref().map_or(self.steps_received, |update| update.environment_steps)
    }
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
    /// Environment steps a second since it was first heard of.
    #[prost(double, tag = "4")]
    pub steps_per_s: f64,
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
