//! Exports the reward model of a run to a file for programs without Goalward.

use std::path::Path;

use anyhow::{Context, Result};
use protocol::durable;
use run::folder::RunFolder;
use run::metadata;

use crate::trained::restored;

/// Writes the ensemble in a run's checkpoint, by default the newest, to `out`. Returns the iteration of the
/// checkpoint.
///
/// # Errors
/// When there is no such intact checkpoint, its reward model has no ensemble, or the file cannot be written.
pub(crate) fn export(folder: &RunFolder, iteration: Option<u64>, out: &Path) -> Result<u64> {
    let config = folder.config()?;
    let (model, iteration) = restored(folder, &config, iteration)?;
    let name = config.reward.model.name;
    let ensemble = model.ensemble().with_context(|| {
        format!("expected a reward model of one trained ensemble, found {name}")
    })?;
    let (ensemble, normalizer) = ensemble.networks();
    let graph = export::ensemble(ensemble, normalizer);
    let graph = graph.with(metadata::of_export(&config, iteration, &model.sha256()));
    let bytes = graph.to_file(out).map_err(anyhow::Error::msg)?;
    durable::write(out, bytes).with_context(|| out.display().to_string())?;
    Ok(iteration)
}
