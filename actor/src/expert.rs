//! Who demonstrates a task: the script of its environment, or a policy that was trained on the
//! environment's own reward.

use anyhow::{Context, Result, ensure};
use protocol::config::RunConfig;
use protocol::run::{POLICY_FILE, RunFolder};
use protocol::task::Task;
use protocol::weights::Weights;

use crate::policy::{Policy, Version};

/// Who demonstrates a task.
pub enum Expert {
    /// The script of the task's environment.
    Script,
    /// A policy, which takes its most probable actions.
    Policy(Box<Policy>, Box<Version>),
}

impl Expert {
    /// The policy of the newest checkpoint of a run.
    pub fn of_run(folder: &RunFolder, task: Task) -> Result<Expert> {
        let config = folder.config()?;
        let (shown, found) = (folder.path().display(), config.task);
        ensure!(found == task, "{shown}: expected a run of {task}, found one of {found}");
        let (_, checkpoint) = folder
            .newest_checkpoint()
            .with_context(|| format!("expected a checkpoint in {shown}, found none"))?;
        Expert::policy(&config, &Weights::load(&checkpoint.join(POLICY_FILE))?)
    }

    fn policy(config: &RunConfig, weights: &Weights) -> Result<Expert> {
        let policy = Policy::new(config);
        let version = policy.version(weights)?;
        Ok(Expert::Policy(Box::new(policy), Box::new(version)))
    }
}
