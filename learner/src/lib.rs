//! The learner: Algorithm 1 of the paper, between actors, proximity service and log.
//!
//! [`run()`] is the process. `trainer` is the loop of the algorithm; [`desk`] is the thread that talks to actors and
//! writes the log at the same time; `service_client` talks to the proximity service. [`algorithm`] holds the policy
//! learners.

mod advantage;
pub mod algorithm;
pub mod batch;
mod beginning;
mod checkpoint;
pub mod cli;
pub mod desk;
mod end;
pub mod ledger;
mod reward_scale;
mod service_client;
pub mod state;
mod trainer;

use anyhow::Result;
use run::folder::RunFolder;
use run::process::Stop;

use crate::trainer::Trainer;

/// Trains a run to its end, from its newest checkpoint if it has one.
///
/// Returns early when a stop is requested, with a checkpoint written if an iteration has ended.
///
/// # Errors
/// When the folder holds no run, the bus or the disk fails, or learning diverges.
pub fn run(folder: &RunFolder, stop: &Stop) -> Result<()> {
    let mut trainer = Trainer::start(folder, stop)?;
    let finished = trainer.train()?;
    if finished { trainer.conclude() } else { trainer.leave() }
}
