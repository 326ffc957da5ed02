//! Runs as the user names them: each folder is a run, has runs in it, or is that of an experiment.

use std::path::PathBuf;

use anyhow::Result;
use run::folder::RunFolder;
use terminal::refusal::wrong_usage;

/// Returns the runs at some folders, in their order; none for a folder without runs.
///
/// # Errors
/// Wrong usage, for the first folder that cannot be read.
pub(crate) fn at(folders: &[PathBuf]) -> Result<Vec<RunFolder>> {
    let mut runs = Vec::new();
    for folder in folders {
        runs.extend(RunFolder::all_at(folder).map_err(|error| {
            wrong_usage(format!("{}: expected a folder of runs: {error}", folder.display()))
        })?);
    }
    Ok(runs)
}
