//! The policy of a run as a file that programs without Goalward read.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use protocol::durable;
use run::checkpoint;
use run::folder::{POLICY_FILE, RunFolder};
use run::metadata;
use serde::Serialize;

use crate::policy::Policy;

/// What was written, as it is printed.
#[derive(Debug, Serialize)]
pub struct Exported {
    /// The file.
    pub file: PathBuf,
    /// Iterations the policy was trained for.
    pub iteration: u64,
}

/// Writes the policy in a run's checkpoint after so many iterations, or else in its newest, to `out`.
///
/// # Errors
/// When there is no such checkpoint that holds, or the file cannot be written.
pub fn export(folder: &RunFolder, iteration: Option<u64>, out: &Path) -> Result<Exported> {
    let config = folder.config()?;
    let found = checkpoint::chosen(folder, iteration, &[POLICY_FILE])?;
    let weights = found.policy()?;
    let scale = config.environment.action_scale();
    let graph = Policy::new(&config).graph(&weights, &scale)?;
    let graph = graph.with(metadata::of_export(&config, found.iteration, &weights.sha256()));
    let bytes = graph.to_file(out).map_err(anyhow::Error::msg)?;
    durable::write(out, bytes).with_context(|| out.display().to_string())?;
    Ok(Exported { file: out.to_owned(), iteration: found.iteration })
}
