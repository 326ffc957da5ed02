//! The messages between gateways. Every call is a request of the host and a reply of the hub.

use anyhow::{Result, ensure};
use bytes::Bytes;
use prost::Message;
use protocol::MAX_ACTORS;
use protocol::messages::{LeaseReply, LeaseRequest};

/// Version of this protocol; gateways with different versions refuse each other.
pub const PROTOCOL: u32 = 4;

/// Largest message, bytes. A host whose trajectory is larger can take no further part.
pub const MOST_BYTES: usize = 32 << 20;

/// Most bytes of trajectories in one message, unless a single trajectory is larger.
pub const TOGETHER_BYTES: usize = 1 << 20;

/// Most trajectories in one message.
pub const TOGETHER: usize = 1024;

/// Longest lease request, bytes: half of what fits into its slot on the learner's bus.
pub const REQUEST_BYTES: usize = 16 << 10;

/// Most leases that one request hands back; an actor holds 16 at a time.
pub const FINISHED: usize = 256;

/// Most actors that a beat names: those of a run, and as many that have just been replaced.
pub const ACTORS: usize = 2 * MAX_ACTORS;

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

impl Beat {
    /// Checks the length of the list.
    pub(crate) fn check(&self) -> Result<()> {
        let found = self.actors.len();
        ensure!(found <= ACTORS, "expected at most {ACTORS} actors of a host, found {found}");
        Ok(())
    }
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
    /// The actor's [`LeaseRequest`], encoded: the decoded one of a liar would take 28 times the memory.
    #[prost(bytes = "bytes", optional, tag = "4")]
    pub request: Option<Bytes>,
}

impl Exchange {
    /// Checks how much the host sends at once.
    pub(crate) fn check(&self) -> Result<()> {
        let found = self.trajectories.len();
        ensure!(found <= TOGETHER, "expected at most {TOGETHER} trajectories, found {found}");
        let found = self.request.as_ref().map_or(0, Bytes::len);
        ensure!(
            found <= REQUEST_BYTES,
            "expected a lease request of at most {REQUEST_BYTES} bytes, found {found}"
        );
        Ok(())
    }

    /// Decodes the actor's request, if there is one.
    pub(crate) fn asked(&self) -> Result<Option<LeaseRequest>> {
        let asked = self.request.clone().map(LeaseRequest::decode).transpose()?;
        let found = asked.as_ref().map_or(0, |asked| asked.finished.len());
        ensure!(found <= FINISHED, "expected at most {FINISHED} finished leases, found {found}");
        Ok(asked)
    }
}

/// The acknowledgement that the trajectories are on the learner's bus, or that nobody waits for them, and the
/// learner's reply.
#[derive(Clone, PartialEq, Message)]
pub struct Answer {
    /// The reply, if there is one yet; otherwise the host repeats its request, without the trajectories.
    #[prost(message, optional, tag = "1")]
    pub reply: Option<LeaseReply>,
}

/// A host leaves.
#[derive(Clone, PartialEq, Message)]
pub struct Goodbye {
    /// The session.
    #[prost(fixed64, tag = "1")]
    pub session: u64,
}

/// The host has left.
#[derive(Clone, PartialEq, Message)]
pub struct Farewell {}

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
