//! `summary.json` as DESIGN describes it, read by a reader that is not the one of `goalward`.

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
    pub env_steps: u64,
    /// Training episodes.
    pub episodes: u64,
    /// Iterations finished.
    pub iterations: u64,
    /// Of the last 100 training episodes, in [0, 1]; none where nothing tells success.
    pub success_rate: Option<f64>,
    /// Episodes after training.
    pub evaluation: Evaluation,
    /// Wall time of training.
    pub wall_s: f64,
    /// Processor time of all processes in that time.
    pub processor_s: f64,
    /// Environment steps per second of wall time.
    pub steps_per_s: f64,
    /// Of the policy's weights.
    pub policy_sha256: String,
    /// Of the reward model's weights.
    pub proximity_sha256: String,
    /// The recorded files.
    pub log: Log,
}

/// Episodes after training.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct Evaluation {
    /// How many.
    pub episodes: u64,
    /// In [0, 1]; none where nothing tells success.
    pub success_rate: Option<f64>,
}

/// The recorded files.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct Log {
    /// How many.
    pub files: u64,
    /// Trajectories in them, those of the evaluation included.
    pub trajectories: u64,
    /// Their size.
    pub bytes: u64,
}

/// The two hashes that say what was learned.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Hashes {
    /// Of the policy's weights.
    pub policy: String,
    /// Of the reward model's weights.
    pub proximity: String,
}

impl Summary {
    /// What was learned.
    pub fn hashes(&self) -> Hashes {
        Hashes { policy: self.policy_sha256.clone(), proximity: self.proximity_sha256.clone() }
    }
}
