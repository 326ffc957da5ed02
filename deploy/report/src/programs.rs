//! What a report requests from a run's programs. `goalward report` implements [`ReportPrograms`] and starts them.

use std::path::PathBuf;

use anyhow::Result;
use run::folder::RunFolder;
use serde::{Deserialize, Serialize};

/// A model's estimates, one number per observation.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct Estimates {
    /// Proximity.
    pub proximity: Vec<f64>,
    /// Standard deviation of the ensemble.
    pub uncertainty: Vec<f64>,
}

/// Requests to a run's programs, which the implementation starts.
pub trait ReportPrograms {
    /// Returns estimates of the reward model in the newest checkpoint of a run for observations.
    ///
    /// # Errors
    /// When there is no checkpoint, or the model cannot score single observations.
    fn estimate(&self, folder: &RunFolder, observations: &[u8]) -> Result<Estimates>;

    /// Runs `episodes` evaluation episodes with the newest policy of a run; returns the file that contains them.
    ///
    /// # Errors
    /// When they cannot be run.
    fn evaluate(&self, folder: &RunFolder, episodes: usize) -> Result<PathBuf>;
}
