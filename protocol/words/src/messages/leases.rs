//! What actors and learner say to each other about leases.

use prost::Message;

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
    /// Of processors, waiting and child processes included.
    #[prost(double, tag = "4")]
    pub processor: f64,
}

impl ActorSeconds {
    /// Whether time can have gone so.
    pub fn is_possible(&self) -> bool {
        let parts = [self.environment, self.inference, self.transport, self.processor];
        parts.iter().all(|seconds| seconds.is_finite() && *seconds >= 0.0)
    }

    /// Adds what another actor, or the same one later, has said.
    pub fn add(&mut self, others: &ActorSeconds) {
        self.environment += others.environment;
        self.inference += others.inference;
        self.transport += others.transport;
        self.processor += others.processor;
    }
}

/// The learner's answer; it comes when there are leases, or the run is over.
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
