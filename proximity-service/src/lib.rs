//! The proximity service learns the reward and answers requests of the learner and queries of any tool.
//!
//! [`run()`] is the process.
//!
//! | module | what it does |
//! |---|---|
//! | `service` | the main loop: receives trajectories, answers requests |
//! | `intake` | the batch of an iteration, from shared memory and from the learner |
//! | [`model`] | the reward models |
//! | `reward` | rewards from proximity and uncertainty (Eq. 5), and from discriminators |
//! | `replay_buffer` | the agent's newest rows, the negatives of Eq. 4 |
//! | `offline_file` | the file from which offline training resumes |
//! | `trained`, `estimate`, `export`, `rescore` | a trained model: restored, queried, exported, scoring a log again |

pub mod cli;
mod estimate;
mod export;
mod intake;
pub mod model;
mod offline_file;
mod replay_buffer;
mod rescore;
mod reward;
mod service;
#[cfg(test)]
mod tests;
mod trained;

use anyhow::Result;
use bus::{Bus, BusAddress, SERVICE_NAME};
use run::folder::RunFolder;
use run::process::Stop;

use crate::service::Service;

/// Serves a run until a stop is requested and the learner is gone.
///
/// # Errors
/// When the folder holds no run, its demonstrations cannot be read, or the bus fails.
pub fn run(folder: &RunFolder, stop: &Stop) -> Result<()> {
    let config = folder.config()?;
    // The service joins the bus before it reads its demonstrations, so that waiting processes see it.
    let bus = Bus::open(&BusAddress::of_run(folder.path())?, SERVICE_NAME)?;
    let model = model::of_run(folder, &config)?;
    Service::open(folder, &config, bus, model)?.serve(stop)
}
