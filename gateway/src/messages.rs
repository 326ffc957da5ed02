//! The messages between gateways. Every call is a request of the host and a reply of the hub.

use bytes::Bytes;
use prost::Message;
use protocol::messages::{LeaseReply, LeaseRequest};

/// Version of this protocol; gateways with different versions refuse each other.
pub const PROTOCOL: u32 = 3;

/// Largest message, bytes. A host whose trajectory is larger can take no further part.
pub const MOST_BYTES: usize = 32 << 20;

/// Most bytes of trajectories in one message, unless a single trajectory is larger.
pub const TOGETHER_BYTES: usize = 1 << 20;

/// Requests the run's configuration.
#[derive(Clone, PartialEq, Message)]
pub struct ConfigurationRequest {
    /// The sender's [`PROTOCOL`].
    #[prost(uint32, tag = "1")]
    pub protocol: u32,
}

/// The run's configuration.
#[derive(Clone, PartialEq, Message)]
pub struct Configuration {
    /// The effective configuration, as TOML text.
    #[prost(string, tag = "1")]
    pub text: String,
}

/// A host introduces itself.
#[derive(Clone, PartialEq, Message)]
pub struct Hello {
    /// The host's [`PROTOCOL`].
    #[prost(uint32, tag = "1")]
    pub protocol: u32,
    /// Random number of this session; every later message carries it.
    #[prost(fixed64, tag = "2")]
    pub session: u64,
    /// The name that the host asks for.
    #[prost(string, tag = "3")]
    pub host: String,
    /// The build of the host's programs.
    #[prost(string, tag = "4")]
    pub build: String,
    /// The host's output of `goalward-actor golden`.
    #[prost(string, tag = "5")]
    pub golden: String,
    /// Whether the host may join although its build differs, provided that its golden hash is the same.
    #[prost(bool, tag = "6")]
    pub other_build: bool,
    /// Number of actors that the host is to run.
    #[prost(uint64, tag = "7")]
    pub actors: u64,
}

/// A host is accepted.
#[derive(Clone, PartialEq, Message)]
pub struct Welcome {
    /// The host's name in the run.
    #[prost(string, tag = "1")]
    pub host: String,
}

/// A host reports that it is alive.
#[derive(Clone, PartialEq, Message)]
pub struct Beat {
    /// The session.
    #[prost(fixed64, tag = "1")]
    pub session: u64,
    /// Names of the living actors on the host's bus.
    #[prost(string, repeated, tag = "2")]
    pub actors: Vec<String>,
    /// Shortest round trip of the latest beats, milliseconds.
    #[prost(double, optional, tag = "3")]
    pub distance_ms: Option<f64>,
}

/// The state of the run.
#[derive(Clone, PartialEq, Message)]
pub struct BeatReply {
    /// Whether the run is over: the host then ends.
    #[prost(bool, tag = "1")]
    pub finished: bool,
    /// Number of actors that the host is to run from now on.
    #[prost(uint64, tag = "2")]
    pub actors: u64,
}

/// Trajectories that an actor has published and, if there is one, its lease request. An actor requests leases when it
/// has finished others, so one message carries both.
#[derive(Clone, PartialEq, Message)]
pub struct Exchange {
    /// The session.
    #[prost(fixed64, tag = "1")]
    pub session: u64,
    /// Trajectories as the actor encoded them.
    #[prost(bytes = "bytes", repeated, tag = "2")]
    pub trajectories: Vec<Bytes>,
    /// Number of the request among those of its actor, from 1. A repeated request gets the same reply.
    #[prost(uint64, tag = "3")]
    pub number: u64,
    /// The actor's request.
    #[prost(message, optional, tag = "4")]
    pub request: Option<LeaseRequest>,
}

/// The acknowledgement that the trajectories are on the learner's bus, or that nobody waits for them, and the
/// learner's reply.
#[derive(Clone, PartialEq, Message)]
pub struct Answer {
    /// The reply, if there is one yet; otherwise the host repeats its request, without the trajectories.
    #[prost(message, optional, tag = "1")]
    pub reply: Option<LeaseReply>,
}

/// Requests weights.
#[derive(Clone, PartialEq, Message)]
pub struct WeightsRequest {
    /// The session.
    #[prost(fixed64, tag = "1")]
    pub session: u64,
    /// The policy version that a lease is acted with.
    #[prost(uint64, tag = "2")]
    pub version: u64,
}

/// The requested weights.
#[derive(Clone, PartialEq, Message)]
pub struct WeightsReply {
    /// The weights as the learner encoded them; `None` if this version is not among the newest.
    #[prost(bytes = "bytes", optional, tag = "1")]
    pub weights: Option<Bytes>,
}
