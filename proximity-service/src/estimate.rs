//! What the trained reward model of a run says of any observations, for `goalward report`
//! (Figures 4d and 10).

use anyhow::Result;
use run::folder::RunFolder;
use serde::Serialize;

use crate::model;
use crate::rescore::restore;

/// What a model says of observations, one number for each, as it is printed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PrintedEstimates {
    /// Proximity.
    pub proximity: Vec<f32>,
    /// Standard deviation of the ensemble.
    pub uncertainty: Vec<f32>,
}

/// Asks the model in the newest checkpoint of a run about whole observations, one after another.
///
/// # Errors
/// When there is no checkpoint, or the bytes are not observations of the run's task.
pub fn estimate(folder: &RunFolder, observations: &[u8]) -> Result<PrintedEstimates> {
    let config = folder.config()?;
    config.task.spec().observation.check(observations)?;
    let mut model = model::of_run(folder, &config)?;
    restore(&mut *model, folder, None)?;
    let estimates = model.estimate(observations)?;
    Ok(PrintedEstimates { proximity: estimates.proximity, uncertainty: estimates.uncertainty })
}
