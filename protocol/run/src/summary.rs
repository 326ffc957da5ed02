//! `summary.json`: the summary of a finished run, written by its learner and read by `goalward`.

use std::fs;

use protocol::build::Build;
use protocol::dropped::shortened;
use protocol::error::MESSAGE_CHARS;
use protocol::{Error, durable};
use serde::{Deserialize, Serialize};

use crate::folder::RunFolder;
use crate::origin::Demonstrations;
use crate::time_to_success::TimeToSuccess;

/// What a finished run has come to.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Name of the task.
    pub task: String,
    /// The method.
    pub method: String,
    /// Name of the preset the configuration came from.
    pub preset: String,
    /// Seed of the run.
    pub seed: u64,
    /// Actor processes the run was configured with.
    pub actors: u64,
    /// Environment steps learned from.
    pub env_steps: u64,
    /// Training episodes learned from.
    pub episodes: u64,
    /// Iterations finished.
    pub iterations: u64,
    /// Of the last 100 training episodes, in [0, 1]; none where there are none, or the task does not tell success.
    pub success_rate: Option<f64>,
    /// Episodes run after training.
    pub evaluation: EvaluationFigures,
    /// Wall time of training, earlier sittings of a resumed run included, seconds.
    pub wall_s: f64,
    /// Processor time of all its processes in that time, seconds.
    #[serde(default)]
    pub processor_s: f64,
    /// What it took until the success rate had reached 50, 90, 95 and 98 %, as far as it has.
    #[serde(default)]
    pub time_to_success: Vec<TimeToSuccess>,
    /// Environment steps per second of wall time.
    pub steps_per_s: f64,
    /// Of the policy's weights.
    pub policy_sha256: String,
    /// Of the reward model's weights.
    pub proximity_sha256: String,
    /// The builds that trained it, one after another; none in a summary from before builds were
    /// recorded.
    #[serde(default)]
    pub builds: Vec<Build>,
    /// What it imitated; none if it imitated nobody, or was trained before this was recorded.
    #[serde(default)]
    pub demonstrations: Option<Demonstrations>,
    /// The recorded files.
    pub log: LogFigures,
    /// Where the time went.
    pub seconds: Seconds,
}

/// Episodes run after training.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct EvaluationFigures {
    /// How many.
    pub episodes: u64,
    /// Share of them that reached the goal; none where there are none, or the task does not tell.
    pub success_rate: Option<f64>,
    /// Mean of the environment's own returns; none where there are no episodes, or in a summary from before
    /// this was recorded.
    #[serde(default)]
    pub mean_return: Option<f64>,
}

/// The recorded files.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LogFigures {
    /// How many.
    pub files: u64,
    /// Trajectories in them, those of the evaluation included.
    pub trajectories: u64,
    /// Their size.
    pub bytes: u64,
}

/// Where the time of the last sitting went, seconds. Actors' parts are summed over actors and lie
/// within `rollout`; `reward_update` runs beside `policy_update` unless it comes first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Seconds {
    /// Waiting for rollouts.
    pub rollout: f64,
    /// Of actors, in environments.
    pub environment: f64,
    /// Of actors, in the policy's network and in drawing actions.
    pub inference: f64,
    /// Of actors, encoding and publishing trajectories.
    pub transport: f64,
    /// Writing the log.
    pub log: f64,
    /// Waiting for scores.
    pub scoring: f64,
    /// Updating the policy.
    pub policy_update: f64,
    /// Of the proximity service, updating the reward model.
    pub reward_update: f64,
}

impl Summary {
    /// Writes the summary of a run; it is there whole or not at all.
    ///
    /// # Errors
    /// [`Error::Summary`] if the disk refuses.
    pub fn save(&self, folder: &RunFolder) -> Result<(), Error> {
        let path = folder.summary_file();
        let failed = |message: String| Error::Summary { path: path.clone(), message };
        let text = serde_json::to_string_pretty(self).map_err(|error| failed(error.to_string()))?;
        durable::write(&path, text + "\n").map_err(|error| failed(error.to_string()))
    }

    /// The summary of a finished run. A damaged one makes no run finished: `remark` is told, and the
    /// run can be continued, which writes it anew.
    pub fn of_finished(folder: &RunFolder, remark: impl FnOnce(&str)) -> Option<Summary> {
        Summary::of_run(folder).unwrap_or_else(|error| {
            remark(&format!("{error}; the run counts as unfinished, --resume writes it anew"));
            None
        })
    }

    /// Reads the summary of a run; none if the run is not finished.
    ///
    /// # Errors
    /// When the file is there but cannot be read or is not a summary.
    pub fn of_run(folder: &RunFolder) -> Result<Option<Summary>, Error> {
        let path = folder.summary_file();
        if !path.exists() {
            return Ok(None);
        }
        let failed = |message: String| Error::Summary { path: path.clone(), message };
        let text = fs::read_to_string(&path).map_err(|error| failed(error.to_string()))?;
        serde_json::from_str(&text)
            .map(Some)
            .map_err(|error| failed(shortened(&error.to_string(), MESSAGE_CHARS)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_damaged_summary_is_named() {
        let directory = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(directory.path());
        assert_eq!(Summary::of_run(&folder).unwrap(), None);
        fs::write(folder.summary_file(), "{").unwrap();
        let error = Summary::of_run(&folder).unwrap_err();
        assert!(error.to_string().contains("summary.json"), "{error}");
    }
}
