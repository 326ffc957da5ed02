//! Whether a run is continued with what it began with: its program, its build and its configuration.

use std::path::Path;

use anyhow::Result;
use mcap_log::recorded_builds;
use protocol::build::Build;
use protocol::table::MODULES;
use run::config::RunConfig;
use run::folder::RunFolder;
use run::origin::recorded_configs;

use crate::description;
use terminal::refusal::{Refusal, wrong_usage};

/// Checks that a task's own program is the one that the run began with, since it decides what the environment does.
///
/// # Errors
/// Wrong usage, when it is another one.
pub(crate) fn refuse_other_program(config: &RunConfig) -> Result<()> {
    let found = description::program_sha256(&config.task).map_err(Refusal::usage)?;
    if found == config.task.program_sha256 {
        return Ok(());
    }
    let shown = config.task.program.as_deref().unwrap_or(Path::new("none")).display();
    Err(wrong_usage(format!(
        "{shown}: expected the program that the run began with, found a rebuilt one: start a new \
         run"
    )))
}

/// Returns how this build differs from the one that last trained the run, in one line that names both; `None` if it
/// does not, or if the run has no log.
///
/// # Errors
/// Wrong usage, when the log cannot be read.
pub(crate) fn other_build(folder: &RunFolder) -> Result<Option<String>> {
    if !folder.log().exists() {
        return Ok(None);
    }
    let (builds, own) = (recorded_builds(&folder.log()).map_err(Refusal::usage)?, Build::own());
    let other = builds.last().and_then(|last| Some((last, last.difference(own)?)));
    Ok(other.map(|(last, (what, _))| {
        let run = folder.path().display();
        let expected = format!("{run}: expected the build that trained the run, {last}");
        format!("{expected}, found {own} (different {what})")
    }))
}

/// Checks that this build is the one that last trained the run, since another build may give another result.
///
/// # Errors
/// Wrong usage, as [`other_build`].
pub(crate) fn refuse_other_build(folder: &RunFolder) -> Result<()> {
    match other_build(folder)? {
        Some(words) => Err(wrong_usage(format!("{words}; --other-build continues it anyway"))),
        None => Ok(()),
    }
}

/// Checks that the configuration was not edited since the run began, since it would give another result.
///
/// # Errors
/// Wrong usage, with the first key that differs.
pub(crate) fn refuse_if_changed(folder: &RunFolder, config: &RunConfig) -> Result<()> {
    if !folder.log().exists() {
        return Ok(());
    }
    let begun = recorded_configs(folder).map_err(Refusal::usage)?;
    let mut differing = begun.iter().flat_map(|begun| begun.result_differences(config));
    let Some((key, [began, found])) = differing.find(|(key, _)| !key.starts_with(MODULES)) else {
        return Ok(());
    };
    Err(wrong_usage(format!(
        "{}: expected {key} = {began}, with which the run began, found {found}",
        folder.config_file().display()
    )))
}
