//! What the program that acts in a task says of it, asked before anything is laid out.

use std::collections::BTreeSet;

use anyhow::{Context, Result};
use protocol::description::Description;
use protocol::digest;
use protocol::setting::{MAKE, SOURCES, Setting, VERSIONS};
use protocol::task::Task;
use run::config::RunConfig;

use crate::programs::{self, Program};
use terminal::refusal::wrong_usage;

/// A configuration whose settings are complete, as the task's own environment has them.
///
/// # Errors
/// Of wrong usage, when the environment does not have such a setting, or has other shapes.
pub(crate) fn complete(config: RunConfig) -> Result<RunConfig> {
    let demonstrations = config.demonstration_setting();
    let description = describe(&config.task, &config.environment, &demonstrations)?;
    let mut config = config.described(description)?;
    config.task.program_sha256 = program_sha256(&config.task)?;
    Ok(config)
}

/// The setting of demonstrations, complete, to be recorded by the task's expert if by nobody else.
///
/// # Errors
/// As [`complete`], and when the expert is needed and the task has none.
pub(crate) fn complete_setting(
    task: &Task,
    setting: &Setting,
    needs_expert: bool,
) -> Result<Setting> {
    let description = describe(task, setting, setting)?;
    if needs_expert && !description.has_expert {
        let expected = "expected a run as --policy, or of a task of Python a function as --expert";
        return Err(wrong_usage(format!("{task} has no expert: {expected}")));
    }
    Ok(description.environment)
}

/// An environment of Python, made with a setting, as a task of this name.
///
/// # Errors
/// Of wrong usage, when Python cannot make it, or it has spaces that no task can have.
pub(crate) fn of_python(name: &str, setting: &Setting) -> Result<Description> {
    described(Program::Actor, name, setting, setting)
}

/// Checks configurations that are to be trained later, each environment once.
///
/// # Errors
/// As [`complete`].
pub(crate) fn check_all<'a>(configs: impl Iterator<Item = &'a RunConfig>) -> Result<()> {
    let mut known = BTreeSet::new();
    for config in configs {
        let (environment, demonstrations) = (&config.environment, config.demonstration_setting());
        if known.insert(format!("{:?} {environment:?} {demonstrations:?}", config.task)) {
            let named = || format!("{} by {}", config.task, config.method);
            complete(config.clone()).with_context(named)?;
        }
    }
    Ok(())
}

/// The configuration of a run that goes on. An environment of Python must still be the one that it began with,
/// before actors are started that could only refuse it; where `other_build` allows for another, the hashes of
/// modules are those of now.
///
/// # Errors
/// Of wrong usage, when its packages have other versions, its modules were changed, or it cannot be made.
pub(crate) fn of_resumed(mut config: RunConfig, other_build: bool) -> Result<RunConfig> {
    if !config.environment.0.contains_key(MAKE) {
        return Ok(config);
    }
    if other_build {
        config.environment.0.remove(SOURCES);
        let began = config.environment.0.get(VERSIONS).cloned();
        let mut completed = complete(config)?;
        // Packages that the run's first build did not name are not what it began with.
        completed.environment.0.remove(VERSIONS);
        completed.environment.0.extend(began.map(|versions| (VERSIONS.to_owned(), versions)));
        return Ok(completed);
    }
    complete(config.clone())?;
    Ok(config)
}

/// SHA-256 of the program that a task brings along; none where it is ours.
///
/// # Errors
/// When it cannot be read.
pub(crate) fn program_sha256(task: &Task) -> Result<Option<String>> {
    let Some(path) = &task.program else { return Ok(None) };
    let hash = digest::sha256_of_file(path);
    hash.map(Some).with_context(|| format!("the program {} of {task}", path.display()))
}

fn describe(task: &Task, environment: &Setting, demonstrations: &Setting) -> Result<Description> {
    described(Program::acting_in(task), &task.name, environment, demonstrations)
}

fn described(
    program: Program,
    name: &str,
    environment: &Setting,
    demonstrations: &Setting,
) -> Result<Description> {
    let mut actor = program.command()?;
    actor
        .args(["describe", name])
        .args(["--environment", &serde_json::to_string(environment)?])
        .args(["--demonstrations", &serde_json::to_string(demonstrations)?]);
    let described: Result<Description, String> =
        programs::result(&mut actor, "describing the task")?;
    described.map_err(wrong_usage)
}
