//! The learner: Algorithm 1 of the paper, between actors, proximity service and log.
//!
//! [`run()`] is the process.
//!
//! | module | what it does |
//! |---|---|
//! | `beginning`, `trainer`, `end` | the start from a checkpoint or from scratch, the loop, evaluation and summary |
//! | [`desk`] | the thread that talks to actors and writes the log at the same time |
//! | [`ledger`] | which leases of a rollout are open, held and done |
//! | `service_client` | requests to the proximity service |
//! | [`batch`], `advantage`, `reward_scale` | the batch of an iteration, its advantages, the scale of its rewards |
//! | [`algorithm`] | the policy learners |
//! | [`state`], `checkpoint` | what is carried from one iteration to the next, and how it is saved |

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
