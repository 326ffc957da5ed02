//! Asks the program that acts in a task to describe it, before a run is laid out.

use std::collections::BTreeSet;

use anyhow::{Context, Result};
use protocol::description::Description;
use protocol::digest;
use protocol::setting::{MAKE, SOURCES, Setting, VERSIONS};
use protocol::task::Task;
use run::config::RunConfig;

use crate::programs::{self, Program};
use terminal::refusal::wrong_usage;

/// Returns the configuration with complete settings, as the task's own environment reports them.
///
/// # Errors
/// Wrong usage, when the environment refuses a setting or has other shapes, or when the task lacks an expert that is
/// needed.
pub(crate) fn complete(config: RunConfig) -> Result<RunConfig> {
    let demonstrations = config.demonstration_setting();
    let description = describe(&config.task, &config.environment, &demonstrations)?;
    let mut config = config.described(description)?;
    config.task.program_sha256 = program_sha256(&config.task)?;
    Ok(config)
}

/// Returns the complete setting of demonstrations. With `needs_expert`, the task must have an expert that can record
/// them.
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
        let expected = "expected --policy RUN or, for a Python task, --expert MODULE:FUNCTION";
        return Err(wrong_usage(format!("{task} has no expert: {expected}")));
    }
    Ok(description.environment)
}

/// Makes a Python environment with `setting` and describes it as a task called `name`.
///
/// # Errors
/// Wrong usage, when Python cannot make the environment, or its spaces do not fit a task.
pub(crate) fn of_python(name: &str, setting: &Setting) -> Result<Description> {
    described(Program::Actor, name, setting, setting)
}

/// Checks configurations that are to be trained later; each environment is checked once.
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

/// Returns the configuration of a run that is continued or evaluated. A Python environment must still be the one that
/// the run began with; this is checked before actors start, which could only refuse it. With `other_build`, the
/// environment's modules may differ, and the configuration gets their current hashes.
///
/// # Errors
/// Wrong usage, when packages have other versions, modules were changed, or the environment cannot be made.
pub(crate) fn of_begun(mut config: RunConfig, other_build: bool) -> Result<RunConfig> {
    if !config.environment.0.contains_key(MAKE) {
        return Ok(config);
    }
    if other_build {
        config.environment.0.remove(SOURCES);
        let began = config.environment.0.get(VERSIONS).cloned();
        let mut completed = complete(config)?;
        // Packages that the run's first build did not record are left out.
        completed.environment.0.remove(VERSIONS);
        completed.environment.0.extend(began.map(|versions| (VERSIONS.to_owned(), versions)));
        return Ok(completed);
    }
    complete(config.clone())?;
    Ok(config)
}

/// Returns the SHA-256 of the task's own program; `None` if the program is ours.
///
/// # Errors
/// When the program cannot be read.
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
