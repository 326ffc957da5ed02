//! A run on several machines: leases, trajectories and weights between the bus of its learner and the
//! buses of other hosts.
//!
//! | module | |
//! |---|---|
//! | [`messages`] | what gateways say to each other, over gRPC and mutual TLS |
//! | [`key`] | who may join: the run's own certificate authority |
//! | [`hub`] | `goalward-gateway serve`, beside the learner |
//! | [`host`] | `goalward-gateway join`, on another machine |
//!
//! Actors and learner are as they are without it. On a host the gateway stands in for the learner: actors
//! ask it for leases, and it reads what they publish. At the hub it stands in for those actors: each has a
//! node on the learner's bus under a name of its own, `actor-0-PROCESS@HOST`, which is gone when the host
//! is, so that the learner hands its leases out again.
//!
//! The host begins every exchange, so one port is enough and the hub never connects to anybody. A question for
//! leases goes with what its actor has published before, or once that is acknowledged, which is when it is on the
//! learner's bus. Questions are numbered, and one that is asked again has the same answer: a lost answer costs no
//! lease.

pub mod cli;
pub mod host;
pub mod hub;
pub mod key;
pub mod messages;

use std::time::Duration;

/// After so long without a word a connection is tried, at either end.
const KEEPALIVE: Duration = Duration::from_secs(1);

/// How long it may take to answer then, before it is given up.
const KEEPALIVE_PATIENCE: Duration = Duration::from_secs(3);

/// Bytes that may be under way unacknowledged in one call, and in all of a connection. HTTP/2 begins with 64 kB,
/// which at 20 ms is 3 MB/s: weights alone would take a quarter of a second.
const WINDOWS: [u32; 2] = [4 << 20, 8 << 20];

/// The calls between gateways.
#[allow(
    missing_docs,
    clippy::missing_errors_doc,
    clippy::too_many_lines,
    reason = "tonic makes it"
)]
pub mod calls {
    tonic::include_proto!("goalward.Gateway");
}
