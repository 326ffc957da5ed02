//! `goalward-gateway join`: the gateway on another machine.
//!
//! The module `desk` stands in for the learner on this machine's bus, in the thread that owns the ports; `link` talks
//! to the hub in a thread of its own. Two bounded channels connect them.

mod actor;
mod desk;
mod link;
mod session;

use anyhow::{Context, Result};
use bytes::Bytes;
use protocol::messages::{LeaseReply, LeaseRequest};
use run::config::RunConfig;
use run::folder::RunFolder;
use run::process::Stop;

use crate::key::JoinKey;
pub use session::{Identity, connect};

/// Number of messages that may wait for the link.
const OUTGOING: usize = 64;

/// Number of messages that may wait for the desk.
const INCOMING: usize = 1024;

/// Messages of the desk to the link.
enum Outgoing {
    /// Trajectories of an actor.
    Deliver { actor: String, trajectories: Vec<Bytes> },
    /// A lease request of an actor, with the trajectories published before it that are not under way yet.
    Ask { number: u64, request: LeaseRequest, trajectories: Vec<Bytes> },
    /// The living actors.
    Alive(Vec<String>),
}

/// Messages of the link to the desk.
enum Incoming {
    /// The trajectories of one [`Outgoing::Deliver`] of the actor are on the learner's bus.
    Delivered { actor: String },
    /// Weights, sent before the first lease that is acted with them.
    Weights(Bytes),
    /// The reply to the actor's request with this number.
    Answered { actor: String, number: u64, reply: LeaseReply },
    /// The run is over.
    Over,
    /// The host can take no further part.
    Failed(anyhow::Error),
}

/// Asks the hub for the run's configuration and writes it into the folder, where actors find it.
///
/// # Errors
/// When the hub cannot be reached or refuses, or the folder cannot be written.
pub fn lay_out(folder: &RunFolder, key: &JoinKey) -> Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let text = runtime.block_on(session::configuration(key))?;
    let origin = format!("of the run at {}", key.address);
    let config = RunConfig::from_text(&text, &origin)?;
    let file = folder.config_file();
    std::fs::write(&file, config.to_text()).with_context(|| file.display().to_string())
}

/// Takes part in a run until it is over or a stop is requested.
///
/// # Errors
/// When the hub refuses this host or is silent for too long, or the bus fails.
pub fn join(folder: &RunFolder, key: &JoinKey, identity: Identity, stop: &Stop) -> Result<()> {
    let (outgoing, orders) = tokio::sync::mpsc::channel(OUTGOING);
    let (incoming, news) = std::sync::mpsc::sync_channel(INCOMING);
    let link =
        link::Setup { folder: folder.clone(), key: key.clone(), identity, stop: stop.clone() };
    let body = move || link::run(link, orders, incoming);
    let link = std::thread::Builder::new().name("link".to_owned()).spawn(body)?;
    let ended = desk::Desk::open(folder, outgoing, news)?.run(stop);
    stop.request();
    // A panic has already been printed by the thread itself.
    link.join().ok();
    ended
}
