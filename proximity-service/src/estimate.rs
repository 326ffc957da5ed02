//! Estimates of a run's trained reward model for given observations, for `goalward report` and `goalward page`
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

/// A model's estimates, one number per observation, as printed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PrintedEstimates {
    /// Proximity of each observation.
    pub proximity: Vec<f32>,
    /// Standard deviation of the ensemble for each observation.
    pub uncertainty: Vec<f32>,
}

/// Queries the model in a checkpoint of a run, by default the newest, about a sequence of whole observations.
///
/// # Errors
/// When there is no checkpoint, the bytes are not observations of the run's task, or the model cannot score single
/// observations.
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

/// A model's score of an episode, as printed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PrintedScore {
    /// Reward of each step (Eq. 5).
    pub rewards: Vec<f32>,
    /// Proximity of each observation; of each step for transitions, and for discriminators that see actions.
    pub proximity: Vec<f32>,
    /// Standard deviation of the ensemble for each proximity.
    pub uncertainty: Vec<f32>,
}

/// Scores an encoded episode under `config` with the model in the newest checkpoint of the run `trained`.
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
