//! What gateways say to each other. Every call is the host's question and the hub's answer.

use bytes::Bytes;
use prost::Message;
use protocol::messages::{LeaseReply, LeaseRequest};

/// Number of this protocol; gateways of two numbers refuse each other.
pub const PROTOCOL: u32 = 3;

/// Most bytes of one message: a host that has a trajectory which is larger takes no part any more.
pub const MOST_BYTES: usize = 32 << 20;

/// Most bytes of trajectories in one message, unless it is one alone.
pub const TOGETHER_BYTES: usize = 1 << 20;

/// Asks what is trained.
#[derive(Clone, PartialEq, Message)]
pub struct ConfigurationRequest {
    /// The asker's [`PROTOCOL`].
    #[prost(uint32, tag = "1")]
    pub protocol: u32,
}

/// What is trained.
#[derive(Clone, PartialEq, Message)]
pub struct Configuration {
    /// The run's effective configuration, TOML.
    #[prost(string, tag = "1")]
    pub text: String,
}

/// A host presents itself.
#[derive(Clone, PartialEq, Message)]
pub struct Hello {
    /// Its [`PROTOCOL`].
    #[prost(uint32, tag = "1")]
    pub protocol: u32,
    /// A random number of this joining; every later message names it.
    #[prost(fixed64, tag = "2")]
    pub session: u64,
    /// What people call the host.
    #[prost(string, tag = "3")]
    pub host: String,
    /// What its programs are built from.
    #[prost(string, tag = "4")]
    pub build: String,
    /// What its actor makes of the episodes of `goalward-actor golden`.
    #[prost(string, tag = "5")]
    pub golden: String,
    /// Whether another build may join whose golden hash is the same.
    #[prost(bool, tag = "6")]
    pub other_build: bool,
    /// How many actors it is to have.
    #[prost(uint64, tag = "7")]
    pub actors: u64,
}

/// A host is accepted.
#[derive(Clone, PartialEq, Message)]
pub struct Welcome {
    /// What the host is called from now on.
    #[prost(string, tag = "1")]
    pub host: String,
}

/// A host lives.
#[derive(Clone, PartialEq, Message)]
pub struct Beat {
    /// The joining.
    #[prost(fixed64, tag = "1")]
    pub session: u64,
    /// Its living actors, by name on its bus.
    #[prost(string, repeated, tag = "2")]
    pub actors: Vec<String>,
    /// How long the fastest of the last beats took, there and back, milliseconds.
    #[prost(double, optional, tag = "3")]
    pub distance_ms: Option<f64>,
}

/// How the run stands.
#[derive(Clone, PartialEq, Message)]
pub struct BeatReply {
    /// The run is over: the host ends.
    #[prost(bool, tag = "1")]
    pub finished: bool,
    /// How many actors the host is to have from now on.
    #[prost(uint64, tag = "2")]
    pub actors: u64,
}

/// What an actor has published, and its question for leases if it has one: to ask is to finish leases, so that
/// one message carries both.
#[derive(Clone, PartialEq, Message)]
pub struct Exchange {
    /// The joining.
    #[prost(fixed64, tag = "1")]
    pub session: u64,
    /// Trajectories as they were encoded by the actor.
    #[prost(bytes = "bytes", repeated, tag = "2")]
    pub trajectories: Vec<Bytes>,
    /// Number of the question among its actor's, from 1. One that is asked again has the same answer.
    #[prost(uint64, tag = "3")]
    pub number: u64,
    /// What the actor asks.
    #[prost(message, optional, tag = "4")]
    pub request: Option<LeaseRequest>,
}

/// The learner's bus has the trajectories, or nobody waits for them; and the learner's answer.
#[derive(Clone, PartialEq, Message)]
pub struct Answer {
    /// None yet: a question is to be asked again, without the trajectories.
    #[prost(message, optional, tag = "1")]
    pub reply: Option<LeaseReply>,
}

/// Asks for weights.
#[derive(Clone, PartialEq, Message)]
pub struct WeightsRequest {
    /// The joining.
    #[prost(fixed64, tag = "1")]
    pub session: u64,
    /// The version that a lease is acted by.
    #[prost(uint64, tag = "2")]
    pub version: u64,
}

/// Weights.
#[derive(Clone, PartialEq, Message)]
pub struct WeightsReply {
    /// As the learner encoded them; none when this version is not among the newest.
    #[prost(bytes = "bytes", optional, tag = "1")]
    pub weights: Option<Bytes>,
}
