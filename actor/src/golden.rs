//! `goalward-actor golden`: a few episodes that must be the same on every machine of a run, as one hash.

use anyhow::Result;
use protocol::digest;
use protocol::trajectory::Encoded;
use run::config::ActionChoice;
use run::folder::RunFolder;

use crate::evaluate::act;
use crate::factory::{Factory, Tasks};
use crate::policy::Policy;

/// Number of episodes.
const EPISODES: u64 = 4;

/// Runs the first evaluation episodes of a run with an untrained policy and sampled actions, and returns
/// SHA-256 of the trajectories. For a task that is not deterministic, only the shapes are hashed.
///
/// # Errors
/// When the task is not among `tasks`, or an environment fails.
pub(crate) fn golden(tasks: Tasks, folder: &RunFolder) -> Result<String> {
    let mut config = folder.config()?;
    let factory = Factory::of_run(tasks, &config)?;
    if !config.task.deterministic {
        return Ok(digest::sha256([format!("{:?}", config.task.spec())]));
    }
    config.evaluation.actions = ActionChoice::Sample;
    let weights = Policy::new(&config).initial_weights(config.seed);
    let trajectories = act(&factory, &config, &weights, EPISODES, config.seed)?;
    Ok(digest::sha256(trajectories.into_iter().map(|trajectory| Encoded::encode(trajectory).bytes)))
}
