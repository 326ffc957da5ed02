//! A run's log with all observations: the recorded log or, if that has only actions, one restored from it.

use std::path::{Path, PathBuf};

use anyhow::Result;
use mcap_log::read_run;
use protocol::durable::{self, TemporaryFolder};
use run::folder::RunFolder;
use run::lost;
use run::origin::recorded_configs;
use serde::Deserialize;

use crate::programs::{self, Program};
use terminal::print::print_remark;
use terminal::refusal::Refusal;

/// A log with all observations. A restored log is removed when this is dropped.
#[derive(Debug)]
pub(crate) enum FullLog {
    /// The run's own log.
    Recorded(PathBuf),
    /// A log restored from the run's own.
    Restored(TemporaryFolder),
}

/// The actor's report about a log that it restored.
#[derive(Debug, Deserialize)]
pub(crate) struct Restored {
    /// Episodes in the new log.
    pub(crate) episodes: u64,
    /// Episodes that had no observations.
    pub(crate) restored: u64,
}

impl FullLog {
    /// Returns the full log of a run, restored in the run's folder if the recorded log has only actions.
    ///
    /// # Errors
    /// When the log cannot be read, or acting its episodes again does not reproduce them.
    pub(crate) fn of(run: &RunFolder) -> Result<FullLog> {
        if recorded_configs(run)?.iter().all(|config| config.log.observations) {
            return Ok(FullLog::Recorded(run.log()));
        }
        print_remark("the log has actions only: acting its episodes again");
        // A process that was killed may have left one.
        durable::clear(run.path())?;
        let folder = TemporaryFolder::beside(&run.path().join("restored-log"))?;
        restore(run, folder.path())?;
        Ok(FullLog::Restored(folder))
    }

    /// Returns the folder of the log.
    pub(crate) fn folder(&self) -> &Path {
        match self {
            FullLog::Recorded(folder) => folder,
            FullLog::Restored(folder) => folder.path(),
        }
    }
}

/// Writes a run's log with all observations into the folder `out`.
///
/// # Errors
/// As [`FullLog::of`].
pub(crate) fn restore(run: &RunFolder, out: &Path) -> Result<Restored> {
    let mut actor = Program::acting_in(&run.config()?.task).command()?;
    programs::result_unless_stopped(
        actor.arg("restore").arg("--run").arg(run.path()).arg("--out").arg(out),
        "restoring",
    )
}

/// Checks that nothing that was recorded is lost from a run's log, since work on the log is incomplete otherwise.
///
/// # Errors
/// Lost data, naming the damaged files, or the expected number of episodes.
pub(crate) fn refuse_loss(run: &RunFolder) -> Result<()> {
    let lost = lost::of_log(run, &read_run(&run.log())?);
    if lost.is_empty() { Ok(()) } else { Err(Refusal::DataLost(lost.join("; ")).into()) }
}
