//! The proximity service: learns the reward and answers for it, to the learner and to any tool.
//!
//! [`run`] is the process, [`service`] its one loop, [`model`] what it learns; [`rescore`] takes a
//! model through a log, [`estimate`](mod@estimate) asks a trained one. All other modules are pure
//! functions of their arguments.

pub mod cli;
pub mod demonstrations;
pub mod estimate;
pub mod experience;
pub mod model;
pub mod rescore;
pub mod reward;
pub mod service;
pub mod target;
#[cfg(test)]
mod tests;

use anyhow::Result;
use protocol::config::{Method, RunConfig};
use protocol::process::Stop;
use protocol::run::RunFolder;

use crate::demonstrations::{Demonstrations, Selection};
use crate::model::{EnvironmentReward, GoalProximity, RewardModel};
use crate::service::Service;

/// Serves a run until the learner is gone and a stop is requested.
pub fn run(folder: &RunFolder, stop: &Stop) -> Result<()> {
    let config = folder.config()?;
    let model = reward_model(folder, &config)?;
    Service::open(folder, &config, model)?.serve(stop)
}

fn reward_model(folder: &RunFolder, config: &RunConfig) -> Result<Box<dyn RewardModel>> {
    let spec = config.task.spec();
    if config.method == Method::EnvironmentReward {
        return Ok(Box::new(EnvironmentReward { observation_bytes: spec.observation.bytes() }));
    }
    let file = config.demonstrations.file.clone().unwrap_or_else(|| folder.demonstrations_file());
    let selection =
        Selection { spec, episodes: config.demonstrations.episodes, run_seed: config.seed };
    let demonstrations = Demonstrations::load(&file, &selection, &config.reward)?;
    let threads = rayon::ThreadPoolBuilder::new()
        .num_threads(config.resources.service_threads)
        .thread_name(|number| format!("ensemble-{number}"))
        .build()?;
    let rate = config.reward_learning_rate();
    let model =
        GoalProximity::new(&spec, &config.reward, rate, config.seed, demonstrations, threads);
    Ok(Box::new(model))
}
