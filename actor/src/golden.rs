//! `goalward-actor golden`: a few episodes that every machine of a run must act alike, as one hash.

use anyhow::Result;
use protocol::digest;
use protocol::trajectory::Encoded;
use run::config::ActionChoice;
use run::folder::RunFolder;

use crate::evaluate::act;
use crate::factory::{Factory, Tasks};
use crate::policy::Policy;

/// How many.
const EPISODES: u64 = 4;

/// Acts the first evaluation episodes of a run by a policy that has learned nothing, with sampled actions, and
/// gives SHA-256 of the trajectories. Of a task that is not deterministic it says the shapes alone.
///
/// # Errors
/// When the task is none of `tasks`, or an environment fails.
pub fn golden(tasks: Tasks, folder: &RunFolder) -> Result<String> {
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
