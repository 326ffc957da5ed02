//! Messages between actors and learner about leases.

use prost::Message;

/// An actor's request for leases. It also hands back those that the actor has finished.
#[derive(Clone, PartialEq, Message)]
pub struct LeaseRequest {
    /// The actor's name on the bus.
    #[prost(string, tag = "1")]
    pub actor: String,
    /// Maximum number of leases that the actor can take now.
    #[prost(uint32, tag = "2")]
    pub capacity: u32,
    /// Leases handed back since the actor's last request: all their trajectories are published, or the actor has
    /// given them up.
    #[prost(message, repeated, tag = "3")]
    pub finished: Vec<Lease>,
    /// How the actor spent its time since its last request.
    #[prost(message, optional, tag = "4")]
    pub seconds: Option<ActorSeconds>,
}

/// How actors spent their time, in seconds, without the time in which they wait for leases.
#[derive(Clone, Copy, PartialEq, Message)]
pub struct ActorSeconds {
    /// Time in environments.
    #[prost(double, tag = "1")]
    pub environment: f64,
    /// Time in the policy network and in sampling actions.
    #[prost(double, tag = "2")]
    pub inference: f64,
    /// Time to encode and publish trajectories.
    #[prost(double, tag = "3")]
    pub transport: f64,
    /// Processor time, including that of child processes.
    #[prost(double, tag = "4")]
    pub processor: f64,
}

impl ActorSeconds {
    /// Returns whether all times are finite and not negative.
    pub fn is_possible(&self) -> bool {
        let parts = [self.environment, self.inference, self.transport, self.processor];
        parts.iter().all(|seconds| seconds.is_finite() && *seconds >= 0.0)
    }

    /// Adds the times that another actor, or the same one later, has reported.
    pub fn add(&mut self, others: &ActorSeconds) {
        self.environment += others.environment;
        self.inference += others.inference;
        self.transport += others.transport;
        self.processor += others.processor;
    }
}

/// The learner's answer, sent once there are leases or the run is over.
#[derive(Clone, PartialEq, Message)]
pub struct LeaseReply {
    /// The leases granted.
    #[prost(message, repeated, tag = "1")]
    pub leases: Vec<Lease>,
    /// Whether the run is over, so that the actor ends.
    #[prost(bool, tag = "2")]
    pub finished: bool,
}

/// The right to run a lane's episodes for one iteration. The resulting episodes depend on nothing else.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Message)]
pub struct Lease {
    /// Whether the episodes are for training or evaluation.
    #[prost(enumeration = "crate::trajectory::Source", tag = "1")]
    pub source: i32,
    /// Iteration that the episodes belong to.
    #[prost(uint64, tag = "2")]
    pub iteration: u64,
    /// Environment stream.
    #[prost(uint64, tag = "3")]
    pub lane: u64,
    /// Version of the policy that acts.
    #[prost(uint64, tag = "4")]
    pub policy_version: u64,
    /// First episode to run.
    #[prost(uint64, tag = "5")]
    pub first_episode: u64,
    /// Minimum number of steps. Episodes are run until both this minimum and `episodes_owed` are reached.
    #[prost(uint64, tag = "6")]
    pub steps_owed: u64,
    /// Minimum number of episodes.
    #[prost(uint64, tag = "7")]
    pub episodes_owed: u64,
}
