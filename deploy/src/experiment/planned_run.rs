//! A run that a plan asks for.

use anyhow::Result;
use run::config::RunConfig;

use crate::demonstrations;
use crate::tasks;
use terminal::refusal::wrong_usage;

/// A run that a plan asks for.
#[derive(Clone, Debug)]
pub(crate) struct PlannedRun {
    /// Task, as `goalward train` takes it.
    pub(crate) task: String,
    /// Effective configuration, with the hash of the task's own program. It names a file of demonstrations only if the
    /// plan does.
    pub(crate) config: RunConfig,
    /// Settings that make this configuration of the task's file and preset, as `goalward train --set` takes them.
    pub(crate) settings: Vec<String>,
}

impl PlannedRun {
    /// Plans the run of a method on a task, with a preset of the task's file.
    ///
    /// # Errors
    /// Wrong usage, when the settings change the method or the seed, are invalid, or contradict the demonstrations.
    pub(super) fn of(
        task: &str,
        preset: Option<&str>,
        method: &str,
        seed: u64,
        settings: Vec<String>,
    ) -> Result<PlannedRun> {
        let config = tasks::configuration(task, preset, &settings)?;
        let config = demonstrations::adopt(config, &settings)?;
        if (config.method.as_str(), config.seed) != (method, seed) {
            return Err(wrong_usage("its settings may change neither method nor seed"));
        }
        if let Some(file) = &config.demonstrations.file {
            demonstrations::check(file, &config)?;
        }
        Ok(PlannedRun { task: task.to_owned(), config, settings })
    }
}
