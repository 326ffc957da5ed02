//! A run's log with all observations: its own, or where it has actions only, one made of it.

use std::path::{Path, PathBuf};

use anyhow::Result;
use mcap_log::read_run;
use protocol::durable;
use run::folder::RunFolder;
use run::loss;
use run::origin::recorded_configs;
use serde::Deserialize;
use tempfile::TempDir;

use crate::programs::{self, Program};
use terminal::print::print_remark;
use terminal::refusal::Refusal;

/// A log with all observations; one that was made goes with it.
#[derive(Debug)]
pub(crate) enum FullLog {
    /// The run's own.
    Recorded(PathBuf),
    /// One that was made of it.
    Restored(TempDir),
}

/// What the actor says of a log that it restored.
#[derive(Debug, Deserialize)]
pub(crate) struct Restored {
    /// Episodes in the new log.
    pub(crate) episodes: u64,
    /// Those of them that had no observations.
    pub(crate) restored: u64,
}

impl FullLog {
    /// The log of a run, restored into the run's folder if it has actions only.
    ///
    /// # Errors
    /// When it cannot be read, or its episodes do not act again as they did.
    pub(crate) fn of(run: &RunFolder) -> Result<FullLog> {
        if recorded_configs(run)?.iter().all(|config| config.log.observations) {
            return Ok(FullLog::Recorded(run.log()));
        }
        print_remark("the log has actions only: acting its episodes again");
        let folder = durable::temporary_folder(&run.path().join("restored-log"))?;
        restore(run, folder.path())?;
        Ok(FullLog::Restored(folder))
    }

    /// Where it is.
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

/// What was done with a run's log is not all that could be, if not all that was recorded is there.
///
/// # Errors
/// Of lost data, naming the files, or how many episodes there are to be.
pub(crate) fn refuse_loss(run: &RunFolder) -> Result<()> {
    let lost = loss::of_log(run, &read_run(&run.log())?);
    if lost.is_empty() { Ok(()) } else { Err(Refusal::DataLost(lost.join("; ")).into()) }
}
