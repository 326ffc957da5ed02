//! Factories that make environments: of a task that the program has, with a setting.

use anyhow::{Result, ensure};
use environments::{Environment, Expert, Registration, Setting, find};
use protocol::setting::{EXPERT, MAKE};
use protocol::task::{Spec, Task};
use run::config::RunConfig;

use crate::episode::{Episode, EpisodeName};
use crate::python;

/// The tasks that a program can act in.
pub type Tasks = &'static [Registration];

/// A factory of the environments of one task with one setting.
#[derive(Clone, Debug)]
pub struct Factory {
    /// Name of the task.
    pub name: String,
    /// The task's registration.
    pub task: &'static Registration,
    setting: Setting,
}

/// A task with a Python environment, which its setting names.
static OF_PYTHON: Registration = Registration::new("python", python::make);

/// The same with an expert, which the setting names, too.
static WITH_EXPERT: Registration =
    Registration::new("python", python::make).with_expert(Expert::Scripted);

impl Factory {
    /// Creates the factory of the named task, or of a Python environment if the setting says what makes it.
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

    /// Creates the factory of the environment that a run's agent acts in.
    ///
    /// # Errors
    /// When the program does not have the task, or has it with other shapes.
    pub fn of_run(tasks: Tasks, config: &RunConfig) -> Result<Factory> {
        Factory::fitting(tasks, config, config.environment.clone())
    }

    /// Creates the factory that [`Factory::of_run`] returns, even if a Python module of the environment was changed
    /// since.
    ///
    /// # Errors
    /// As [`Factory::of_run`].
    pub(crate) fn of_changed_run(tasks: Tasks, config: &RunConfig) -> Result<Factory> {
        Factory::fitting(tasks, config, python::as_recorded(&config.environment))
    }

    fn fitting(tasks: Tasks, config: &RunConfig, setting: Setting) -> Result<Factory> {
        let factory = Factory::new(tasks, &config.task.name, setting)?;
        let (expected, found) = (config.task.spec(), factory.make()?.spec());
        let name = &config.task.name;
        ensure!(expected == found, "{name}: expected {expected:?}, found {found:?}");
        Ok(factory)
    }

    /// Creates the factory for re-simulating a run's episodes. A Python module of the environment may have changed: the
    /// comparison with the recorded episodes tells whether that matters.
    ///
    /// # Errors
    /// When the task is not deterministic, and for the reasons of [`Factory::of_run`].
    pub(crate) fn for_resimulation(tasks: Tasks, config: &RunConfig) -> Result<Factory> {
        let name = &config.task.name;
        ensure!(
            config.task.deterministic,
            "{name}: expected a task whose episodes can be re-simulated"
        );
        Factory::of_changed_run(tasks, config)
    }

    /// Returns a factory of the same task with another setting.
    pub fn with_setting(&self, setting: Setting) -> Factory {
        Factory { setting, ..self.clone() }
    }

    /// Makes an environment.
    ///
    /// # Errors
    /// When the task does not have such a setting.
    pub fn make(&self) -> Result<Box<dyn Environment>> {
        Ok((self.task.make)(&self.setting)?)
    }

    /// Makes an environment that renders pictures, if it is a Python environment; others have only solids to draw.
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

    /// Begins the named episode, in the environment of an earlier episode if there is one, else in a new environment.
    ///
    /// # Errors
    /// When the task does not have such a setting, or the environment cannot be reset.
    pub fn begin(&self, name: EpisodeName, earlier: Option<Episode>) -> Result<Episode> {
        let Some(mut episode) = earlier else {
            return Episode::begin(self.make()?, &self.name, name);
        };
        episode.begin_again(name)?;
        Ok(episode)
    }

    /// Returns what the rest of a run has to know of this environment's task.
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
