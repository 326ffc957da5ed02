//! What the page asks of the programs of a run, which others start.

use std::path::Path;

use anyhow::Result;
use protocol::trajectory::Trajectory;
use report::programs::Estimates;
use run::folder::RunFolder;
use serde::{Deserialize, Serialize};

/// What the page asks of the programs of a run, which others start.
pub trait Programs: Send + Sync {
    /// Acts a recorded episode of a run again and writes it to a new file, with its observations and what a
    /// viewer draws of it. `setting` is that of its environment, as JSON, where it is not the run's; one of
    /// Python renders `pictures`, if it can.
    ///
    /// # Errors
    /// When it does not act again as it was recorded.
    fn draw(
        &self,
        folder: &RunFolder,
        setting: Option<&str>,
        episode: &Trajectory,
        pictures: bool,
        out: &Path,
    ) -> Result<()>;

    /// What the model in a checkpoint of a run, in the newest where none is named, says of observations.
    ///
    /// # Errors
    /// When there is none, or it cannot tell single observations.
    fn estimate(
        &self,
        folder: &RunFolder,
        checkpoint: Option<u64>,
        observations: &[u8],
    ) -> Result<Estimates>;

    /// What an episode would have earned from another reward: `changes` are such as `reward.form=absolute`, or
    /// `model=FOLDER` for the trained model of another run.
    ///
    /// # Errors
    /// When a change is not of the reward, or there is no such model.
    fn score(&self, folder: &RunFolder, changes: &[String], episode: &Trajectory) -> Result<Score>;

    /// The processes of a run; none where nobody trains it.
    ///
    /// # Errors
    /// When its bus cannot be listed.
    fn processes(&self, folder: &RunFolder) -> Result<Option<Processes>>;
}

/// What a reward model says of an episode.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct Score {
    /// One for each step.
    pub rewards: Vec<f32>,
    /// One for each observation; of transitions, and of discriminators that see actions, one for each step.
    pub proximity: Vec<f32>,
    /// As many, standard deviations of the ensemble.
    pub uncertainty: Vec<f32>,
}

/// The processes of a live run.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Processes {
    /// Why the run does not go on as it should, if that can be seen.
    pub trouble: Option<String>,
    /// What a row has of a process.
    pub head: [&'static str; 8],
    /// A row for each.
    pub rows: Vec<[String; 8]>,
    /// A line for each other machine that takes part.
    pub hosts: Vec<String>,
}
