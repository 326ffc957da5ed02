//! The built-in tasks, each with everything that is known about it besides its environment.

use crate::ant::{self, Ant};
use crate::fetch::{Fetch, FetchTask};
use crate::navigation::Navigation;
use crate::{Environment, EnvironmentError, Setting};

/// A task that a program can act in.
#[derive(Clone, Copy, Debug)]
pub struct Registration {
    /// Name in commands and logs.
    pub name: &'static str,
    /// Makes the task's environment with a setting.
    pub make: fn(&Setting) -> Result<Box<dyn Environment>, EnvironmentError>,
    /// The expert that demonstrates the task.
    pub expert: Expert,
    /// Keys of the setting that change what observations mean. A policy trained under one value must not act under
    /// another.
    pub observed: &'static [&'static str],
}

/// The expert that demonstrates a task.
#[derive(Clone, Copy, Debug)]
pub enum Expert {
    /// No expert comes with the task; the policy of a run can demonstrate it.
    None,
    /// The environment's own script, by [`Environment::expert_action`].
    Scripted,
    /// A policy that was trained on the environment's own reward.
    Policy {
        /// The configuration of the run that trained it, as TOML text.
        config: &'static str,
        /// The policy's weights, as a safetensors file.
        weights: &'static [u8],
    },
}

impl Registration {
    /// Makes the registration of a task without an expert.
    pub const fn new(
        name: &'static str,
        make: fn(&Setting) -> Result<Box<dyn Environment>, EnvironmentError>,
    ) -> Registration {
        Registration { name, make, expert: Expert::None, observed: &[] }
    }

    /// Returns the same task with an expert.
    pub const fn with_expert(self, expert: Expert) -> Registration {
        Registration { expert, ..self }
    }
}

/// The tasks of the paper, in its order.
pub const BUILT_IN: &[Registration] = &[
    Registration::new("navigation", |setting| Ok(Box::new(Navigation::new(setting.read()?)?)))
        .with_expert(Expert::Scripted),
    Registration::new("fetch-pick", |setting| {
        Ok(Box::new(Fetch::new(FetchTask::Pick, setting.read()?)?))
    })
    .with_expert(Expert::Scripted),
    Registration::new("fetch-push", |setting| {
        Ok(Box::new(Fetch::new(FetchTask::Push, setting.read()?)?))
    })
    .with_expert(Expert::Scripted),
    Registration {
        observed: &["contact_forces"],
        ..Registration::new("ant-reach", |setting| Ok(Box::new(Ant::new(setting.read()?)?)))
            .with_expert(ant::EXPERT)
    },
];

/// Finds the task with this name.
///
/// # Errors
/// [`EnvironmentError::UnknownTask`], with the known names, when there is no such task.
pub fn find<'a>(
    tasks: &'a [Registration],
    name: &str,
) -> Result<&'a Registration, EnvironmentError> {
    tasks.iter().find(|task| task.name == name).ok_or_else(|| {
        let known: Vec<_> = tasks.iter().map(|task| task.name).collect();
        EnvironmentError::UnknownTask { found: name.to_owned(), known: known.join(", ") }
    })
}

/// Makes the environment of a built-in task.
///
/// # Errors
/// When there is no such task, or it does not accept the setting.
pub fn create(task: &str, setting: &Setting) -> Result<Box<dyn Environment>, EnvironmentError> {
    (find(BUILT_IN, task)?.make)(setting)
}
