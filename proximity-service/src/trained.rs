//! The trained model of a run: made from its configuration and restored from one of its checkpoints.

use anyhow::{Context, Result, ensure};
use protocol::task::Spec;
use run::checkpoint;
use run::config::RunConfig;
use run::folder::{PROXIMITY_FILE, RunFolder};

use crate::model::{self, RewardModel};

/// Returns the model in a checkpoint of a run, by default the newest, and the iteration of the checkpoint.
///
/// # Errors
/// When there is no such intact checkpoint, or it or the run's demonstrations cannot be read.
pub(crate) fn restored(
    run: &RunFolder,
    config: &RunConfig,
    iteration: Option<u64>,
) -> Result<(Box<dyn RewardModel>, u64)> {
    let mut model = model::of_run(run, config)?;
    let found = checkpoint::chosen(run, iteration, &[PROXIMITY_FILE])?;
    let tensors = found.load(PROXIMITY_FILE)?;
    let fitted = model.restore(&tensors).map_err(anyhow::Error::msg);
    fitted.with_context(|| run.path().display().to_string())?;
    Ok((model, found.iteration))
}

/// Returns the model of the run `trained` with what it has learned, to score episodes of a task. `config` is the run's,
/// possibly with other values of what scoring reads ([`RunConfig::for_scoring`]).
///
/// # Errors
/// When the run's demonstrations or checkpoint cannot be read, or its task has other shapes.
pub(crate) fn trained_model(
    trained: &RunFolder,
    config: &RunConfig,
    task: &Spec,
) -> Result<Box<dyn RewardModel>> {
    let own = config.task.spec();
    ensure!(
        (own.observation, own.action) == (task.observation, task.action),
        "{}: expected a model of {:?} and {:?}, found one of {:?} and {:?}",
        trained.path().display(),
        task.observation,
        task.action,
        own.observation,
        own.action
    );
    if config.reward.model.trains {
        return Ok(restored(trained, config, None)?.0);
    }
    // A model that learns nothing consists only of its demonstrations.
    model::of_run(trained, config)
}
