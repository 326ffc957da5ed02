//! Runs on several machines: gateways exchange leases, trajectories and weights between the learner's bus and the
//! buses of other hosts.
//!
//! | module | |
//! |---|---|
//! | [`messages`] | the messages between gateways, over gRPC and mutual TLS |
//! | [`key`] | who may join: the run's own certificate authority |
//! | [`hub`] | `goalward-gateway serve`, beside the learner |
//! | [`host`] | `goalward-gateway join`, on another machine |
//!
//! Actors and learner are the same as in a run on one machine. On a host the gateway stands in for the learner: actors
//! request leases from it, and it reads what they publish. At the hub the gateway stands in for those actors: each has
//! a node of its own on the learner's bus, named `actor-0-PROCESS@HOST`. The node is gone when the host is, so that
//! the learner grants its leases to others.
//!
//! The host begins every exchange, so one port is enough and the hub never connects to anybody. A lease request
//! travels together with the trajectories that its actor has published before, or waits until the hub acknowledges
//! that they are on the learner's bus. Requests are numbered, and a repeated request gets the same reply, so a lost
//! reply costs no lease.

pub mod cli;
pub mod host;
pub mod hub;
pub mod key;
pub mod messages;

use std::time::Duration;

/// Idle time after which either end checks a connection.
const KEEPALIVE: Duration = Duration::from_secs(1);

/// How long such a check may take before the connection is given up.
const KEEPALIVE_PATIENCE: Duration = Duration::from_secs(3);

/// HTTP/2 flow-control windows of one call and of a whole connection, bytes. The default of 64 kB allows 3 MB/s at a
/// round trip of 20 ms; the weights alone would take a quarter of a second.
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
