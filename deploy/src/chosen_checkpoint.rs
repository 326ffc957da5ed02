//! The checkpoint that a verb takes: the one that the user names, or the newest.

use anyhow::Result;
use run::checkpoint;
use run::folder::RunFolder;
use terminal::refusal::Refusal;

/// Returns the iterations of the checkpoint whose `files` a verb takes. A live run may save another one before the
/// verb's programs look, so they are told this number.
///
/// # Errors
/// When there is none; wrong usage, when it is one that the user has named.
pub(crate) fn iterations(run: &RunFolder, named: Option<u64>, files: &[&str]) -> Result<u64> {
    let chosen = checkpoint::chosen(run, named, files).map(|checkpoint| checkpoint.iteration);
    Ok(match named {
        Some(_) => chosen.map_err(Refusal::usage)?,
        None => chosen?,
    })
}
