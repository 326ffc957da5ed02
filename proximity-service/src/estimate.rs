//! What a trained reward model of a run says of any observations, for `goalward report` and `goalward page`
//! (Figures 4d and 10).

use anyhow::{Context, Result};
use bytes::Bytes;
use protocol::messages::Score;
use protocol::trajectory::Encoded;
use run::config::RunConfig;
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

/// Asks the model in a checkpoint of a run, in the newest where none is named, about whole observations, one
/// after another.
///
/// # Errors
/// When there is no checkpoint, or the bytes are not observations of the run's task.
pub fn estimate(
    folder: &RunFolder,
    checkpoint: Option<u64>,
    observations: &[u8],
) -> Result<PrintedEstimates> {
    let config = folder.config()?;
    config.task.spec().observation.check(observations)?;
    let mut model = model::of_run(folder, &config)?;
    restore(&mut *model, folder, checkpoint)?;
    let estimates = model.estimate(observations)?;
    Ok(PrintedEstimates { proximity: estimates.proximity, uncertainty: estimates.uncertainty })
}

/// What a model says of an episode, as it is printed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PrintedScore {
    /// One for each step (Eq. 5).
    pub rewards: Vec<f32>,
    /// One for each observation; of transitions, and of discriminators that see actions, one for each step.
    pub proximity: Vec<f32>,
    /// As many, standard deviations of the ensemble.
    pub uncertainty: Vec<f32>,
}

/// What an encoded episode would have earned under `config` from the model in the newest checkpoint of a run.
///
/// # Errors
/// When there is no checkpoint, or the bytes are not an episode of the task.
pub fn score(
    folder: &RunFolder,
    config: &RunConfig,
    trained: &RunFolder,
    episode: Bytes,
) -> Result<PrintedScore> {
    let episode = Encoded::decode(episode, &config.task.spec())?;
    let mut model = model::of_run(folder, config)?;
    restore(&mut *model, trained, None)?;
    let scores = model.score(episode.trajectory.iteration, &[episode]);
    let Score { rewards, proximity, uncertainty, .. } =
        scores.into_iter().next().context("expected a score, found none")?;
    Ok(PrintedScore { rewards, proximity, uncertainty })
}
