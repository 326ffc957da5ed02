//! What a report asks of the programs of a run, which others start.

use std::path::PathBuf;

use anyhow::Result;
use run::folder::RunFolder;
use serde::{Deserialize, Serialize};

/// What a model says of observations, one number for each.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct Estimates {
    /// Proximity.
    pub proximity: Vec<f64>,
    /// Standard deviation of the ensemble.
    pub uncertainty: Vec<f64>,
}

/// What a report asks of the programs of a run.
pub trait Programs {
    /// What the model in the newest checkpoint of a run says of observations.
    ///
    /// # Errors
    /// When there is none, or it cannot tell single observations.
    fn estimate(&self, folder: &RunFolder, observations: &[u8]) -> Result<Estimates>;

    /// Runs so many episodes with the newest policy of a run; the file they are in.
    ///
    /// # Errors
    /// When they cannot be run.
    fn evaluate(&self, folder: &RunFolder, episodes: usize) -> Result<PathBuf>;
}
