//! What the page requests from a run's programs. `goalward page` implements [`PagePrograms`] and starts them.

use std::path::Path;

use anyhow::Result;
use protocol::trajectory::Trajectory;
use report::programs::Estimates;
use run::folder::RunFolder;
use serde::{Deserialize, Serialize};

/// Requests to a run's programs, which the implementation starts.
pub trait PagePrograms: Send + Sync {
    /// Re-simulates a recorded episode of a run and writes it to the new file `out`, with its observations and
    /// scenes. `setting` is the environment's setting as JSON, or `None` for the run's. With `pictures`, a Python
    /// environment renders pictures, if it can.
    ///
    /// # Errors
    /// When re-simulation does not reproduce the recorded episode.
    fn draw(
        &self,
        folder: &RunFolder,
        setting: Option<&str>,
        episode: &Trajectory,
        pictures: bool,
        out: &Path,
    ) -> Result<()>;

    /// Returns estimates of the reward model in a checkpoint of a run, by default the newest, for observations.
    ///
    /// # Errors
    /// When there is no such checkpoint, or the model cannot score single observations.
    fn estimate(
        &self,
        folder: &RunFolder,
        checkpoint: Option<u64>,
        observations: &[u8],
    ) -> Result<Estimates>;

    /// Scores an episode under another reward. Examples of `changes` are `reward.form=absolute`, and `model=FOLDER`
    /// for the trained model of another run.
    ///
    /// # Errors
    /// When a change is not to the reward, or there is no such model.
    fn score(&self, folder: &RunFolder, changes: &[String], episode: &Trajectory) -> Result<Score>;

    /// Returns the processes of a run; `None` if it is not being trained.
    ///
    /// # Errors
    /// When the processes on its bus cannot be listed.
    fn processes(&self, folder: &RunFolder) -> Result<Option<Processes>>;
}

/// A reward model's score of an episode.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct Score {
    /// Reward of each step.
    pub rewards: Vec<f32>,
    /// Proximity of each observation; of each step for transitions, and for discriminators that see actions.
    pub proximity: Vec<f32>,
    /// Standard deviation of the ensemble for each proximity.
    pub uncertainty: Vec<f32>,
}

/// The processes of a live run.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Processes {
    /// Why the run does not make progress as it should, if known.
    pub trouble: Option<String>,
    /// The column names.
    pub head: [&'static str; 8],
    /// A row for each process.
    pub rows: Vec<[String; 8]>,
    /// A line for each other machine that takes part in the run.
    pub hosts: Vec<String>,
}
