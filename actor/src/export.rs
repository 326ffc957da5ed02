//! Export of a run's policy to a file that programs without Goalward can read.

use std::path::Path;

use anyhow::{Context, Result};
use protocol::durable;
use run::checkpoint;
use run::folder::{POLICY_FILE, RunFolder};
use run::metadata;

use crate::policy::Policy;

/// Writes the policy of a run's checkpoint after `iteration` iterations, or else of its newest checkpoint, to
/// `out`. Returns the number of iterations of that checkpoint.
///
/// # Errors
/// When there is no such intact checkpoint, or the file cannot be written.
pub(crate) fn export(folder: &RunFolder, iteration: Option<u64>, out: &Path) -> Result<u64> {
    let config = folder.config()?;
    let found = checkpoint::chosen(folder, iteration, &[POLICY_FILE])?;
    let weights = found.policy()?;
    let scale = config.environment.action_scale();
    let graph = Policy::new(&config).graph(&weights, &scale)?;
    let graph = graph.with(metadata::of_export(&config, found.iteration, &weights.sha256()));
    let bytes = graph.to_file(out).map_err(anyhow::Error::msg)?;
    durable::write(out, bytes).with_context(|| out.display().to_string())?;
    Ok(found.iteration)
}
