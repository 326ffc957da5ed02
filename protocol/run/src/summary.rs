//! `summary.json`: the summary of a finished run, written by its learner and read by `goalward`.

use std::fs;

use protocol::build::Build;
use protocol::dropped::shortened;
use protocol::error::MESSAGE_CHARS;
use protocol::{Error, durable, weights};
use serde::{Deserialize, Serialize};

use crate::folder::RunFolder;
use crate::origin::Demonstrations;
use crate::time_to_success::TimeToSuccess;

/// The results of a finished run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Name of the task.
    pub task: String,
    /// Name of the method.
    pub method: String,
    /// Name of the preset the configuration came from.
    pub preset: String,
    /// Seed of the run.
    pub seed: u64,
    /// Actor processes the run was configured with.
    pub actors: u64,
    /// Environment steps learned from; called `env_steps` in earlier summaries.
    #[serde(alias = "env_steps")]
    pub environment_steps: u64,
    /// Training episodes learned from.
    pub episodes: u64,
    /// Iterations finished.
    pub iterations: u64,
    /// Success rate of the last 100 training episodes, in [0, 1]; `None` if there are no episodes,
    /// or the task does not tell success.
    pub success_rate: Option<f64>,
    /// Results of the evaluation after training.
    pub evaluation: EvaluationFigures,
    /// Wall time of training, including the time before a run was resumed, seconds.
    pub wall_s: f64,
    /// Processor time of all the run's processes in that time, seconds.
    #[serde(default)]
    pub processor_s: f64,
    /// What the run took to reach success rates of 50, 90, 95 and 98 %, for those that it reached.
    #[serde(default)]
    pub time_to_success: Vec<TimeToSuccess>,
    /// Environment steps per second of wall time.
    pub steps_per_s: f64,
    /// SHA-256 of the policy's weights.
    pub policy_sha256: String,
    /// SHA-256 of the reward model's weights; left out where it is that of no weights. Called `proximity_sha256` in
    /// earlier summaries, which have the hash of no weights, too.
    #[serde(
        alias = "proximity_sha256",
        default = "of_no_weights",
        skip_serializing_if = "is_of_no_weights"
    )]
    pub reward_model_sha256: String,
    /// The builds that trained it, in order; empty in a summary from before builds were recorded.
    #[serde(default)]
    pub builds: Vec<Build>,
    /// What it imitated; `None` if it did not imitate, or in a summary from before this was recorded.
    #[serde(default)]
    pub demonstrations: Option<Demonstrations>,
    /// The recorded files.
    pub log: LogFigures,
    /// Where the time went.
    pub seconds: Seconds,
}

/// Results of the evaluation after training.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct EvaluationFigures {
    /// Number of episodes.
    pub episodes: u64,
    /// Share of them that reached the goal; `None` if there are no episodes, or the task does not tell success.
    pub success_rate: Option<f64>,
    /// Mean of the environment's own returns; `None` if there are no episodes, or in a summary from
    /// before this was recorded.
    #[serde(default)]
    pub mean_return: Option<f64>,
}

/// The recorded files.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LogFigures {
    /// Number of files.
    pub files: u64,
    /// Trajectories in them, including those of the evaluation.
    pub trajectories: u64,
    /// Their size in bytes.
    pub bytes: u64,
}

/// Where the time went since the run was last started or resumed, seconds. `rollout`, `scoring`, `policy_update` and
/// `reward_update` follow each other. The actors' parts are summed over actors and lie within `rollout`; the log is
/// written in parallel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Seconds {
    /// Waiting for rollouts.
    pub rollout: f64,
    /// Actors: stepping environments.
    pub environment: f64,
    /// Actors: evaluating the policy's network and sampling actions.
    pub inference: f64,
    /// Actors: encoding and publishing trajectories.
    pub transport: f64,
    /// Writing the log.
    pub log: f64,
    /// Waiting for scores.
    pub scoring: f64,
    /// Updating the policy.
    pub policy_update: f64,
    /// Waiting for the reward model's update, beyond the policy update if the two run at the same time.
    pub reward_update: f64,
}

impl Summary {
    /// Writes the summary of a run; the file is written whole or not at all.
    ///
    /// # Errors
    /// [`Error::Summary`] if the disk refuses.
    pub fn save(&self, folder: &RunFolder) -> Result<(), Error> {
        let path = folder.summary_file();
        let failed = |message: String| Error::Summary { path: path.clone(), message };
        let text = serde_json::to_string_pretty(self).map_err(|error| failed(error.to_string()))?;
        durable::write(&path, text + "\n").map_err(|error| failed(error.to_string()))
    }

    /// Returns the summary of a finished run. With a damaged summary the run counts as unfinished:
    /// `remark` is called, and resuming the run writes the summary again.
    pub fn of_finished(folder: &RunFolder, remark: impl FnOnce(&str)) -> Option<Summary> {
        Summary::of_run(folder).unwrap_or_else(|error| {
            remark(&format!("{error}; the run counts as unfinished, --resume writes it again"));
            None
        })
    }

    /// Reads the summary of a run; `None` if the run is not finished.
    ///
    /// # Errors
    /// If the file exists but cannot be read or is not a summary.
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

fn of_no_weights() -> String {
    weights::sha256([])
}

fn is_of_no_weights(hash: &str) -> bool {
    hash == of_no_weights()
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

    #[test]
    fn a_summary_names_what_there_is_and_earlier_names_are_read() {
        let text = |reward_model: &str| {
            format!(
                r#"{{"task": "navigation", "method": "m", "preset": "p", "seed": 7, "actors": 2,
                "env_steps": 90, "episodes": 9, "iterations": 3, "success_rate": null,
                "evaluation": {{"episodes": 0, "success_rate": null}}, "wall_s": 2.5,
                "time_to_success":
                    [{{"success_rate": 0.5, "env_steps": 60, "wall_s": 1.0, "processor_s": 2.0}}],
                "steps_per_s": 36.0, "policy_sha256": "ab", "proximity_sha256": "{reward_model}",
                "log": {{"files": 2, "trajectories": 9, "bytes": 900}},
                "seconds": {{"rollout": 1, "environment": 1, "inference": 1, "transport": 1,
                    "log": 1, "scoring": 1, "policy_update": 1, "reward_update": 1}}}}"#
            )
        };
        for (hash, shown) in [("cd".to_owned(), Some("cd")), (of_no_weights(), None)] {
            let earlier: Summary = serde_json::from_str(&text(&hash)).unwrap();
            assert_eq!((earlier.environment_steps, &earlier.reward_model_sha256), (90, &hash));
            let value = serde_json::to_value(&earlier).unwrap();
            assert_eq!(value["environment_steps"], 90);
            assert_eq!(value["time_to_success"][0]["environment_steps"], 60);
            let named = value.get("reward_model_sha256").and_then(serde_json::Value::as_str);
            assert_eq!(named, shown);
            for name in ["env_steps", "proximity_sha256"] {
                assert!(value.get(name).is_none(), "{value}");
            }
            assert_eq!(serde_json::from_value::<Summary>(value).unwrap(), earlier);
        }
    }
}
