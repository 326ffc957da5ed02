//! Where training begins: afresh, or from the newest checkpoint and the log before it.

use anyhow::{Context, Result, anyhow};
use mcap_log::{Batches, Record, log_files, read_run, repair};
use protocol::durable;
use protocol::tensors::Tensors;
use run::checkpoint;
use run::config::RunConfig;
use run::folder::{LEARNER_FILE, RunFolder};

use crate::algorithm::{self, PolicyLearner};
use crate::state::State;

/// The policy learner and the state of a run, as its newest checkpoint has them.
pub(crate) struct Beginning {
    pub(crate) learner: Box<dyn PolicyLearner>,
    pub(crate) state: State,
}

impl Beginning {
    /// Seals the log that an interrupted run left, and reads its newest checkpoint.
    pub(crate) fn of_run(folder: &RunFolder, config: &RunConfig) -> Result<Beginning> {
        durable::create_folder(&folder.log())?;
        for file in log_files(&folder.log())?.into_iter().filter(|file| file.active) {
            tracing::info!("{}", repair(&file.path)?);
        }
        let mut beginning = Beginning::fresh(folder, config)?;
        let found = checkpoint::settle(folder)?;
        found.remarks().iter().for_each(|remark| tracing::warn!("{remark}"));
        let Some(newest) = found.newest else { return Ok(beginning) };
        let iteration = newest.iteration;
        tracing::info!("continuing after iteration {iteration}");
        beginning
            .restore(&newest.load(LEARNER_FILE)?)
            .map_err(|message| anyhow!(message))
            .with_context(|| format!("checkpoint {}", newest.folder.display()))?;
        if config.learner.replays() {
            remember(folder, config, iteration, &mut *beginning.learner)?;
        }
        Ok(beginning)
    }

    fn fresh(folder: &RunFolder, config: &RunConfig) -> Result<Beginning> {
        let demonstrations = match config.learner.imitates() {
            true => run::demonstrations::load(folder, config)?,
            false => Vec::new(),
        };
        let (learner, policy) = algorithm::create(config, &demonstrations);
        Ok(Beginning { learner, state: State::fresh(policy, config.rollout.lanes) })
    }

    fn restore(&mut self, tensors: &Tensors) -> Result<(), String> {
        self.state.restore(tensors)?;
        self.learner.restore(tensors)
    }
}

/// Gives a learner the batches of the iterations before `iteration`, from the log: a replay buffer
/// lies in no checkpoint, because the log has it already.
fn remember(
    folder: &RunFolder,
    config: &RunConfig,
    iteration: u64,
    learner: &mut dyn PolicyLearner,
) -> Result<()> {
    let mut batches = Batches::new(config.task.spec());
    for entry in read_run(&folder.log())? {
        match entry?.record {
            Record::Trajectory(bytes) => batches.add(bytes)?,
            Record::PolicyUpdate(update) if update.iteration < iteration => {
                learner.remember(&batches.take(&update)?);
            }
            _ => {}
        }
    }
    Ok(())
}
