//! Who makes environments: a task that the program has, with a setting.

use anyhow::{Result, ensure};
use environments::{Environment, Registration, Setting, find};
use protocol::task::{Spec, Task};
use run::config::RunConfig;

use crate::episode::{Episode, EpisodeName};

/// The tasks that a program can act in.
pub type Tasks = &'static [Registration];

/// Makes the environments of one task with one setting.
#[derive(Clone, Debug)]
pub struct Factory {
    /// The task.
    pub task: &'static Registration,
    setting: Setting,
}

impl Factory {
    /// That of the named task.
    ///
    /// # Errors
    /// When the program does not have the task.
    pub fn new(tasks: Tasks, name: &str, setting: Setting) -> Result<Factory> {
        Ok(Factory { task: find(tasks, name)?, setting })
    }

    /// That of the environment of a run's agent.
    ///
    /// # Errors
    /// When the program does not have the task, or has it with other shapes.
    pub fn of_run(tasks: Tasks, config: &RunConfig) -> Result<Factory> {
        let factory = Factory::new(tasks, &config.task.name, config.environment.clone())?;
        let (expected, found) = (config.task.spec(), factory.make()?.spec());
        let name = &config.task.name;
        ensure!(expected == found, "{name}: expected {expected:?}, found {found:?}");
        Ok(factory)
    }

    /// The same task with another setting.
    pub fn with_setting(&self, setting: Setting) -> Factory {
        Factory { setting, ..*self }
    }

    /// An environment.
    ///
    /// # Errors
    /// When the task does not have such a setting.
    pub fn make(&self) -> Result<Box<dyn Environment>> {
        Ok((self.task.make)(&self.setting)?)
    }

    /// The named episode, begun in an environment of its own.
    ///
    /// # Errors
    /// When there is no such setting, or no such start.
    pub fn begin(&self, name: EpisodeName) -> Result<Episode> {
        Episode::begin(self.make()?, self.task.name, name)
    }

    /// What others have to know of the task whose environments have these shapes.
    pub fn described(&self, spec: Spec) -> Task {
        let Spec { observation, action, horizon_steps } = spec;
        Task {
            name: self.task.name.to_owned(),
            observation,
            action,
            horizon_steps,
            labels: Vec::new(),
            deterministic: true,
            tells_success: self.task.tells_success,
            program: None,
            program_sha256: None,
        }
    }
}
