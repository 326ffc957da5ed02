//! Who makes environments: a task that the program has, with a setting.

use anyhow::{Result, ensure};
use environments::{Environment, Expert, Registration, Setting, find};
use protocol::setting::{EXPERT, MAKE};
use protocol::task::{Spec, Task};
use run::config::RunConfig;

use crate::episode::{Episode, EpisodeName};
use crate::python;

/// The tasks that a program can act in.
pub type Tasks = &'static [Registration];

/// Makes the environments of one task with one setting.
#[derive(Clone, Debug)]
pub struct Factory {
    /// What the task is called.
    pub name: String,
    /// What is known of it beyond its environment.
    pub task: &'static Registration,
    setting: Setting,
}

/// A task whose environments are of Python; its setting says which.
static OF_PYTHON: Registration = Registration::new("python", python::make);

/// The same with an expert, of whom the setting says, too.
static WITH_EXPERT: Registration =
    Registration::new("python", python::make).with_expert(Expert::Scripted);

impl Factory {
    /// That of the named task; of an environment of Python if its setting says what makes it.
    ///
    /// # Errors
    /// When the program does not have the task.
    pub fn new(tasks: Tasks, name: &str, setting: Setting) -> Result<Factory> {
        let has = |key| setting.0.contains_key(key);
        let task = match (has(MAKE), has(EXPERT)) {
            (true, true) => &WITH_EXPERT,
            (true, false) => &OF_PYTHON,
            (false, _) => find(tasks, name)?,
        };
        Ok(Factory { name: name.to_owned(), task, setting })
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
        Factory { setting, ..self.clone() }
    }

    /// An environment.
    ///
    /// # Errors
    /// When the task does not have such a setting.
    pub fn make(&self) -> Result<Box<dyn Environment>> {
        Ok((self.task.make)(&self.setting)?)
    }

    /// An environment that renders pictures, if it is of Python; else one that draws its solids alone.
    ///
    /// # Errors
    /// As [`Factory::make`].
    pub fn rendering(&self) -> Result<Box<dyn Environment>> {
        let mut setting = self.setting.clone();
        if setting.0.contains_key(MAKE) {
            setting.0.insert(python::RENDER.to_owned(), true.into());
        }
        self.with_setting(setting).make()
    }

    /// The named episode, begun where an earlier one was, or in an environment of its own.
    ///
    /// # Errors
    /// When there is no such setting, or no such start.
    pub fn begin(&self, name: EpisodeName, earlier: Option<Episode>) -> Result<Episode> {
        let Some(mut episode) = earlier else {
            return Episode::begin(self.make()?, &self.name, name);
        };
        episode.begin_again(name)?;
        Ok(episode)
    }

    /// What others have to know of the task of this environment.
    pub fn described(&self, environment: &dyn Environment) -> Task {
        let Spec { observation, action, horizon_steps } = environment.spec();
        Task {
            name: self.name.clone(),
            observation,
            action,
            horizon_steps,
            labels: environment.labels(),
            deterministic: true,
            tells_success: environment.tells_success(),
            program: None,
            program_sha256: None,
        }
    }
}
