//! The proximity service learns the reward and answers requests of the learner and queries of any tool.
//!
//! [`run()`] is the process, `service` its main loop, and [`model`] has the reward models. `rescore` scores a log with
//! another model, `estimate` queries a trained one, and `export` writes one to a file.

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
