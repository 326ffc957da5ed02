//! `summary.json`, read independently of `goalward`'s own reader.

use serde::Deserialize;

/// The summary of a finished run.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct Summary {
    /// Name of the task.
    pub task: String,
    /// Name of the method.
    pub method: String,
    /// Name of the preset.
    pub preset: String,
    /// Seed of the run.
    pub seed: u64,
    /// Actor processes the run was configured with.
    pub actors: u64,
    /// Environment steps learned from.
    pub environment_steps: u64,
    /// Training episodes.
    pub episodes: u64,
    /// Iterations finished.
    pub iterations: u64,
    /// Success rate of the last 100 training episodes, in [0, 1]; `None` if the task does not tell success.
    pub success_rate: Option<f64>,
    /// Evaluation episodes after training.
    pub evaluation: Evaluation,
    /// Wall time of training.
    pub wall_s: f64,
    /// Processor time of all processes in that time.
    pub processor_s: f64,
    /// Environment steps per second of wall time.
    pub steps_per_s: f64,
    /// SHA-256 of the policy's weights.
    pub policy_sha256: String,
    /// SHA-256 of the reward model's weights; empty if the method has none.
    #[serde(default)]
    pub reward_model_sha256: String,
    /// The recorded files.
    pub log: Log,
}

/// Evaluation episodes after training.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct Evaluation {
    /// Number of episodes.
    pub episodes: u64,
    /// Success rate in [0, 1]; `None` if the task does not tell success.
    pub success_rate: Option<f64>,
}

/// The recorded files.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct Log {
    /// Number of files.
    pub files: u64,
    /// Trajectories in them, including those of the evaluation.
    pub trajectories: u64,
    /// Total size of the files.
    pub bytes: u64,
}

/// The two hashes that identify what was learned.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Hashes {
    /// SHA-256 of the policy's weights.
    pub policy: String,
    /// SHA-256 of the reward model's weights.
    pub proximity: String,
}

impl Summary {
    /// The hashes of the final weights.
    pub fn hashes(&self) -> Hashes {
        Hashes { policy: self.policy_sha256.clone(), proximity: self.reward_model_sha256.clone() }
    }
}
