//! The proximity service: learns the reward and answers for it, to the learner and to any tool.
//!
//! [`run()`] is the process, [`service`] its one loop, [`model`] what it learns; [`rescore`] takes a
//! model through a log, [`estimate`](mod@estimate) asks a trained one, [`export`](mod@export) hands it out.

pub mod cli;
pub mod estimate;
pub mod export;
mod intake;
pub mod model;
mod offline_file;
pub mod replay_buffer;
pub mod rescore;
pub mod reward;
pub mod service;
#[cfg(test)]
mod tests;

use anyhow::Result;
use bus::{Bus, BusAddress, SERVICE_NAME};
use run::folder::RunFolder;
use run::process::Stop;

use crate::service::Service;

/// Serves a run until the learner is gone and a stop is requested.
///
/// # Errors
/// When the folder holds no run, its demonstrations cannot be read, the bus fails, or the model
/// diverges.
pub fn run(folder: &RunFolder, stop: &Stop) -> Result<()> {
    let config = folder.config()?;
    // It is on the bus before it has read its demonstrations, which may take long: who waits sees it.
    let bus = Bus::open(&BusAddress::of_run(folder.path())?, SERVICE_NAME)?;
    let model = model::of_run(folder, &config)?;
    Service::open(folder, &config, bus, model)?.serve(stop)
}
