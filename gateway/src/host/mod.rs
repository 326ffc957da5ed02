//! `goalward-gateway join`: another machine's end.
//!
//! The module `desk` stands in for the learner on this machine's bus, in the thread that owns its ports; `link`
//! talks to the hub in a thread of its own. Between them are two bounded channels.

mod actor;
mod desk;
mod link;
mod session;

use std::path::Path;

use anyhow::{Context, Result};
use bytes::Bytes;
use protocol::messages::{LeaseReply, LeaseRequest};
use run::config::RunConfig;
use run::folder::RunFolder;
use run::process::Stop;

use crate::key::JoinKey;
pub use session::{Identity, connect};

/// What waits for the link at most.
const OUTGOING: usize = 64;

/// What waits for the desk at most.
const INCOMING: usize = 1024;

/// What the desk has for the hub.
enum Outgoing {
    /// Trajectories of an actor.
    Deliver { actor: String, trajectories: Vec<Bytes> },
    /// A question of an actor, and what it published before that is not under way yet.
    Ask { number: u64, request: LeaseRequest, trajectories: Vec<Bytes> },
    /// These actors live.
    Alive(Vec<String>),
}

/// What the link has for the desk.
enum Incoming {
    /// Trajectories of an actor, those of one [`Outgoing::Deliver`], are on the learner's bus.
    Delivered { actor: String },
    /// Weights, before the first lease that is acted by them.
    Weights(Bytes),
    /// The answer to an actor's question of this number.
    Answered { actor: String, number: u64, reply: LeaseReply },
    /// The run is over.
    Over,
    /// The host cannot take part any more.
    Failed(anyhow::Error),
}

/// Asks the hub what is trained, and lays out a folder in which actors find it.
///
/// # Errors
/// When the hub cannot be reached, refuses, or the folder cannot be written.
pub fn lay_out(folder: &RunFolder, key: &JoinKey) -> Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let text = runtime.block_on(session::configuration(key))?;
    let origin = format!("of the run at {}", key.address);
    let config = RunConfig::from_text(&text, &origin)?;
    let write = |path: &Path| std::fs::write(path, config.to_text());
    let file = folder.config_file();
    write(&file).with_context(|| file.display().to_string())
}

/// Takes part in a run until it is over or a stop is requested.
///
/// # Errors
/// When the hub refuses this host or is not heard of for long, or the bus fails.
pub fn join(folder: &RunFolder, key: &JoinKey, identity: Identity, stop: &Stop) -> Result<()> {
    let (outgoing, orders) = tokio::sync::mpsc::channel(OUTGOING);
    let (incoming, news) = std::sync::mpsc::sync_channel(INCOMING);
    let link =
        link::Setup { folder: folder.clone(), key: key.clone(), identity, stop: stop.clone() };
    let body = move || link::run(link, orders, incoming);
    let link = std::thread::Builder::new().name("link".to_owned()).spawn(body)?;
    let ended = desk::Desk::open(folder, outgoing, news)?.run(stop);
    stop.request();
    // The panic itself has been printed by the thread.
    link.join().ok();
    ended
}
