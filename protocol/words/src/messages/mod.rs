//! Messages between the processes, besides trajectories.
//!
//! [`Score`], [`PolicyUpdate`], [`RewardUpdate`] and [`Checkpoint`] are recorded (schema in `schema/goalward.proto`).
//! Leases, weights, requests to the proximity service and a run's progress are not; they go over the bus, those of
//! other machines through gateways. Episodes to be audited go through a pipe.

mod audit;
mod leases;
mod service;

use prost::Message;

use crate::trajectory::TrajectoryKey;

pub use audit::AuditRequest;
pub use leases::{ActorSeconds, Lease, LeaseReply, LeaseRequest};
pub use service::{
    Answer, Ask, BatchRequest, Begin, Estimates, IterationRequest, Missing, Pretraining, Query,
    Save, Saved, Scores, ServiceReply, ServiceRequest,
};

/// The reward model's output for one trajectory.
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
    /// Number of updates the reward model had had when it answered.
    #[prost(uint64, tag = "4")]
    pub model_version: u64,
    /// Rewards, one per step (Eq. 5).
    #[prost(float, repeated, tag = "5")]
    pub rewards: Vec<f32>,
    /// Proximity in [0, 1], one per observation. Models of transitions, and discriminators that see actions, have one
    /// per step; models that estimate nothing have none.
    #[prost(float, repeated, tag = "6")]
    pub proximity: Vec<f32>,
    /// Standard deviations of the ensemble, as many as there are proximities.
    #[prost(float, repeated, tag = "7")]
    pub uncertainty: Vec<f32>,
}

/// One policy update, which results in `policy_version`.
#[derive(Clone, PartialEq, Message)]
pub struct PolicyUpdate {
    /// The iteration, counted from 0.
    #[prost(uint64, tag = "1")]
    pub iteration: u64,
    /// Number of updates the policy has had, including this one.
    #[prost(uint64, tag = "2")]
    pub policy_version: u64,
    /// Environment steps taken so far, including this iteration.
    #[prost(uint64, tag = "3")]
    pub environment_steps: u64,
    /// Training episodes finished so far.
    #[prost(uint64, tag = "4")]
    pub episodes: u64,
    /// The trajectories of the batch, in order.
    #[prost(message, repeated, tag = "5")]
    pub consumed: Vec<TrajectoryKey>,
    /// The iteration, which names the random stream of minibatches, except SQIL's.
    #[prost(uint64, tag = "6")]
    pub minibatch_seed: u64,
    /// Learning rate of the update.
    #[prost(double, tag = "7")]
    pub learning_rate: f64,
    /// Policy loss, averaged over the minibatches: PPO's clipped surrogate, the mean negative log-likelihood of
    /// actions, or the actor's loss of soft actor-critic.
    #[prost(double, tag = "8")]
    pub policy_loss: f64,
    /// Loss of the value function or of the Q-functions.
    #[prost(double, tag = "9")]
    pub value_loss: f64,
    /// Entropy of the policy, in nats.
    #[prost(double, tag = "10")]
    pub entropy: f64,
    /// Approximate KL divergence, in nats: the mean of `(ratio - 1) - ln ratio`.
    #[prost(double, tag = "11")]
    pub approximate_kl: f64,
    /// Fraction of samples outside the clip range.
    #[prost(double, tag = "12")]
    pub clip_fraction: f64,
    /// Norm of the gradient before clipping.
    #[prost(double, tag = "13")]
    pub gradient_norm: f64,
    /// Success rate of the last 100 training episodes; NaN before the first, or if the task does not report success.
    #[prost(double, tag = "14")]
    pub success_rate: f64,
    /// Mean reward per step, as scored.
    #[prost(double, tag = "15")]
    pub mean_reward: f64,
    /// Mean proximity in the batch.
    #[prost(double, tag = "16")]
    pub mean_proximity: f64,
    /// Mean uncertainty in the batch.
    #[prost(double, tag = "17")]
    pub mean_uncertainty: f64,
    /// Mean number of steps of the batch's episodes.
    #[prost(double, tag = "18")]
    pub mean_episode_steps: f64,
    /// SHA-256 of the policy's weights after the update.
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
    /// Loss on held-out demonstrations; 0 if the learner holds none out.
    #[prost(double, tag = "23")]
    pub held_out_loss: f64,
    /// Wall time of training so far, including offline training and the time before a resume.
    #[prost(double, tag = "24")]
    pub wall_s: f64,
    /// Processor time of all processes of the run during `wall_s`.
    #[prost(double, tag = "25")]
    pub processor_s: f64,
}

/// One update of the reward model. The first is its offline training.
#[derive(Clone, PartialEq, Message)]
pub struct RewardUpdate {
    /// The iteration; offline training has the number of the first one.
    #[prost(uint64, tag = "1")]
    pub iteration: u64,
    /// Number of updates the model has had, including this one.
    #[prost(uint64, tag = "2")]
    pub model_version: u64,
    /// Number of optimizer steps in this update.
    #[prost(uint64, tag = "3")]
    pub gradient_steps: u64,
    /// First term of Eq. 4.
    #[prost(double, tag = "4")]
    pub demonstration_loss: f64,
    /// Second term of Eq. 4, times `reward.agent_weight`.
    #[prost(double, tag = "5")]
    pub agent_loss: f64,
    /// SHA-256 of all members' weights after the update.
    #[prost(string, tag = "6")]
    pub weights_sha256: String,
    /// Number of the agent's samples in the replay buffer.
    #[prost(uint64, tag = "7")]
    pub experience: u64,
    /// Wall time of the update.
    #[prost(double, tag = "8")]
    pub seconds: f64,
    /// Processor time of the proximity service since its previous update.
    #[prost(double, tag = "9")]
    pub processor_s: f64,
}

/// A checkpoint of learner and proximity service, taken together.
#[derive(Clone, PartialEq, Message)]
pub struct Checkpoint {
    /// Number of finished iterations.
    #[prost(uint64, tag = "1")]
    pub iteration: u64,
    /// The checkpoint's folder, relative to the run.
    #[prost(string, tag = "2")]
    pub path: String,
    /// SHA-256 of the policy's weights.
    #[prost(string, tag = "3")]
    pub policy_sha256: String,
    /// SHA-256 of the reward model's weights.
    #[prost(string, tag = "4")]
    pub proximity_sha256: String,
    /// SHA-256 of the policy's file. This hash and the next two are empty in logs of older builds.
    #[prost(string, tag = "5")]
    pub policy_file_sha256: String,
    /// SHA-256 of the learner's file.
    #[prost(string, tag = "6")]
    pub learner_file_sha256: String,
    /// SHA-256 of the proximity service's file.
    #[prost(string, tag = "7")]
    pub proximity_file_sha256: String,
}

/// The progress of a run, which the learner publishes without waiting for readers.
#[derive(Clone, PartialEq, Message)]
pub struct Progress {
    /// What the learner is doing.
    #[prost(enumeration = "Phase", tag = "1")]
    pub phase: i32,
    /// The newest policy update, if there is one.
    #[prost(message, optional, tag = "2")]
    pub update: Option<PolicyUpdate>,
    /// The newest update of the reward model, if there is one.
    #[prost(message, optional, tag = "3")]
    pub reward_update: Option<RewardUpdate>,
    /// Number of environment steps the run is to take.
    #[prost(uint64, tag = "4")]
    pub steps_wanted: u64,
    /// Number of environment steps received, including those of the unfinished rollout.
    #[prost(uint64, tag = "5")]
    pub steps_received: u64,
    /// Number of actors on the bus.
    #[prost(uint32, tag = "6")]
    pub actors: u32,
    /// Number of leases handed out and not finished.
    #[prost(uint32, tag = "7")]
    pub leases: u32,
    /// Number of versions by which the acting policy is older than the newest one.
    #[prost(uint32, tag = "8")]
    pub lag: u32,
    /// Wall time of training, including the time before a resume.
    #[prost(double, tag = "9")]
    pub wall_s: f64,
    /// Bytes written to the log since the learner started.
    #[prost(uint64, tag = "10")]
    pub log_bytes: u64,
    /// Progress of offline training, while it is under way.
    #[prost(message, optional, tag = "11")]
    pub pretraining: Option<Pretraining>,
    /// The actors that the learner has heard from, sorted by name.
    #[prost(message, repeated, tag = "12")]
    pub actors_heard: Vec<ActorHeard>,
}

impl Progress {
    /// Returns the number of environment steps learned from or, before the first update since a start, of those
    /// received.
    pub fn environment_steps(&self) -> u64 {
        self.update.as_ref().map_or(self.steps_received, |update| update.environment_steps)
    }
}

/// What the learner knows about an actor.
#[derive(Clone, PartialEq, Message)]
pub struct ActorHeard {
    /// Its name on the bus.
    #[prost(string, tag = "1")]
    pub name: String,
    /// Number of unfinished leases it holds.
    #[prost(uint32, tag = "2")]
    pub leases: u32,
    /// Seconds since its last request or trajectory.
    #[prost(double, tag = "3")]
    pub ago_s: f64,
    /// Environment steps per second since it was first heard from.
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
    /// The run is over.
    Finished = 3,
    /// Waiting for room on the disk.
    DiskFull = 4,
}
