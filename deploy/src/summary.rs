//! `summary.json`: what the learner says of a finished run.

use std::path::Path;

use anyhow::{Context, Result};
use protocol::run::RunFolder;
use serde::Deserialize;

use crate::figures;

/// Figures of a finished run, as its learner wrote them.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub(crate) struct Summary {
    task: String,
    method: String,
    preset: String,
    seed: u64,
    actors: u64,
    env_steps: u64,
    episodes: u64,
    iterations: u64,
    success_rate: f64,
    evaluation: Evaluation,
    wall_s: f64,
    steps_per_s: f64,
    policy_sha256: String,
    proximity_sha256: String,
    log: Log,
    seconds: Seconds,
}

/// Where the time of the last sitting went. Actors' parts are summed over actors and lie within
/// `rollout`; `reward_update` runs beside `policy_update` unless it comes first.
#[derive(Clone, Debug, PartialEq, Deserialize)]
struct Seconds {
    rollout: f64,
    environment: f64,
    inference: f64,
    transport: f64,
    log: f64,
    scoring: f64,
    policy_update: f64,
    reward_update: f64,
}

impl Seconds {
    /// Shares of the wall time of iterations, and within the rollout shares of the actors' work.
    fn shares(&self) -> [(&'static str, String); 2] {
        let share = |part: f64, whole: f64| figures::percent(part / whole.max(1e-9), 1);
        let wall = self.rollout + self.scoring + self.policy_update;
        let work = self.environment + self.inference + self.transport;
        let stages = format!(
            "rollout {}, scoring {}, policy update {}; beside them: ensemble update {}, log {}",
            share(self.rollout, wall),
            share(self.scoring, wall),
            share(self.policy_update, wall),
            share(self.reward_update, wall),
            share(self.log, wall),
        );
        let actors = format!(
            "inference {}, transport {}, environment {} of {} of work",
            share(self.inference, work),
            share(self.transport, work),
            share(self.environment, work),
            figures::duration(work),
        );
        [("where time went", stages), ("where actors' time went", actors)]
    }
}

#[derive(Clone, Debug, PartialEq, Deserialize)]
struct Evaluation {
    episodes: u64,
    success_rate: f64,
}

#[derive(Clone, Debug, PartialEq, Deserialize)]
struct Log {
    files: u64,
    trajectories: u64,
    bytes: u64,
}

impl Summary {
    /// Reads the summary of a run; none if the run is not finished.
    ///
    /// # Errors
    /// When the file is there but cannot be read or is not a summary.
    pub(crate) fn of_run(folder: &RunFolder) -> Result<Option<Summary>> {
        let path = folder.summary_file();
        if !path.exists() {
            return Ok(None);
        }
        Self::read(&path).map(Some)
    }

    fn read(path: &Path) -> Result<Summary> {
        let shown = || format!("summary {}", path.display());
        let text = std::fs::read_to_string(path).with_context(shown)?;
        serde_json::from_str(&text).with_context(shown)
    }

    /// The figures as a table, one row a line.
    pub(crate) fn table(&self) -> String {
        let evaluation = format!(
            "{} of {} episodes",
            figures::percent(self.evaluation.success_rate, 1),
            figures::count(self.evaluation.episodes)
        );
        let steps = format!(
            "{} in {} iterations",
            figures::count(self.env_steps),
            figures::count(self.iterations)
        );
        let time = format!(
            "{}, {}, actors: {}",
            figures::duration(self.wall_s),
            figures::rate(self.steps_per_s),
            self.actors
        );
        let log = format!(
            "{} in {} files, {} trajectories",
            figures::bytes(self.log.bytes),
            figures::count(self.log.files),
            figures::count(self.log.trajectories)
        );
        let [stages, actors] = self.seconds.shares();
        figures::table(&[
            ("run", format!("{}, {}, preset {}", self.task, self.method, self.preset)),
            ("seed", self.seed.to_string()),
            ("success, last 100 training episodes", figures::percent(self.success_rate, 1)),
            ("success, evaluation", evaluation),
            ("environment steps", steps),
            ("episodes", figures::count(self.episodes)),
            ("time", time),
            ("policy sha256", self.policy_sha256.clone()),
            ("proximity sha256", self.proximity_sha256.clone()),
            ("log", log),
            stages,
            actors,
        ])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = r#"{
        "task": "navigation", "method": "goal-proximity", "preset": "paper", "seed": 7,
        "actors": 2, "env_steps": 1503232, "episodes": 70123, "iterations": 367,
        "success_rate": 0.97, "evaluation": {"episodes": 200, "success_rate": 0.965},
        "wall_s": 251.0, "steps_per_s": 5989.0, "policy_sha256": "ab", "proximity_sha256": "cd",
        "log": {"files": 3, "trajectories": 70123, "bytes": 43200000},
        "seconds": {"rollout": 20, "environment": 1, "inference": 30, "transport": 1, "log": 2,
            "scoring": 30, "policy_update": 50, "reward_update": 10}
    }"#;

    #[test]
    fn a_summary_becomes_a_table() {
        let directory = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(directory.path());
        assert_eq!(Summary::of_run(&folder).unwrap(), None);
        std::fs::write(folder.summary_file(), TEXT).unwrap();
        let table = Summary::of_run(&folder).unwrap().unwrap().table();
        for part in [
            "97.0 %",
            "96.5 % of 200",
            "1,503,232 in 367",
            "4 min 11 s",
            "41.2 MiB in 3",
            "scoring 30.0 %",
        ] {
            assert!(table.contains(part), "expected {part} in\n{table}");
        }
    }

    #[test]
    fn a_damaged_summary_is_named() {
        let directory = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(directory.path());
        std::fs::write(folder.summary_file(), "{").unwrap();
        let error = Summary::of_run(&folder).unwrap_err();
        assert!(format!("{error:#}").contains("summary.json"));
    }
}
