//! The tasks there are, each with everything that is known of it beyond its environment.

use crate::ant::{self, Ant};
use crate::fetch::{Fetch, FetchTask};
use crate::navigation::Navigation;
use crate::{Environment, EnvironmentError, Setting};

/// A task that a program can act in.
#[derive(Clone, Copy, Debug)]
pub struct Registration {
    /// What people and logs call it.
    pub name: &'static str,
    /// Makes its environment with a setting.
    pub make: fn(&Setting) -> Result<Box<dyn Environment>, EnvironmentError>,
    /// Who demonstrates it.
    pub expert: Expert,
    /// Keys of its setting that change what an observation says: who learned under one value is not
    /// asked to act under another.
    pub observed: &'static [&'static str],
}

/// Who demonstrates a task.
#[derive(Clone, Copy, Debug)]
pub enum Expert {
    /// Nobody but a run's policy.
    None,
    /// The environment itself, by [`Environment::expert_action`].
    Scripted,
    /// A policy that was trained on the environment's own reward.
    Policy {
        /// The configuration of its run, a TOML text.
        config: &'static str,
        /// Its weights, a safetensors file.
        weights: &'static [u8],
    },
}

impl Registration {
    /// A task without an expert.
    pub const fn new(
        name: &'static str,
        make: fn(&Setting) -> Result<Box<dyn Environment>, EnvironmentError>,
    ) -> Registration {
        Registration { name, make, expert: Expert::None, observed: &[] }
    }

    /// The same task with an expert.
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

/// The task of that name.
///
/// # Errors
/// [`EnvironmentError::UnknownTask`] names those there are.
pub fn find<'a>(
    tasks: &'a [Registration],
    name: &str,
) -> Result<&'a Registration, EnvironmentError> {
    tasks.iter().find(|task| task.name == name).ok_or_else(|| {
        let known: Vec<_> = tasks.iter().map(|task| task.name).collect();
        EnvironmentError::UnknownTask { found: name.to_owned(), known: known.join(", ") }
    })
}

/// Makes the environment of a task of the paper.
///
/// # Errors
/// When there is no such task, or it does not have such a setting.
pub fn create(task: &str, setting: &Setting) -> Result<Box<dyn Environment>, EnvironmentError> {
    (find(BUILT_IN, task)?.make)(setting)
}
