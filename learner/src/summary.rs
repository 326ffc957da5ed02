//! How a run ends: evaluation, last checkpoint, `summary.json`.

use std::fs;

use anyhow::{Context, Result};
use protocol::messages::Phase;
use protocol::trajectory::Encoded;
use protocol::weights;
use serde::Serialize;

use crate::trainer::Trainer;

/// Figures of a finished run, as `summary.json` holds them.
#[derive(Debug, Serialize)]
struct Summary {
    task: String,
    method: protocol::config::Method,
    preset: String,
    seed: u64,
    actors: u64,
    env_steps: u64,
    episodes: u64,
    iterations: u64,
    /// Of the last 100 training episodes.
    success_rate: f64,
    evaluation: Evaluation,
    wall_s: f64,
    steps_per_s: f64,
    policy_sha256: String,
    proximity_sha256: String,
    log: Log,
    seconds: Seconds,
}

/// Where the time of the last sitting went, seconds. Actors' parts are summed over actors and lie
/// within `rollout`; `reward_update` runs beside `policy_update`.
#[derive(Debug, Default, Serialize)]
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

#[derive(Debug, Serialize)]
struct Evaluation {
    episodes: u64,
    success_rate: f64,
}

#[derive(Debug, Serialize)]
struct Log {
    files: u64,
    trajectories: u64,
    bytes: u64,
}

impl Trainer {
    /// Ends a run that has been stopped: what it has learned is saved.
    pub(crate) fn leave(mut self) -> Result<()> {
        if self.state.iteration > 0 {
            self.save()?;
        }
        self.desk.finish()?;
        Ok(())
    }

    /// Ends a run that has been trained to its end.
    pub(crate) fn conclude(mut self) -> Result<()> {
        self.save()?;
        let Some(evaluation) = self.evaluate()? else { return self.leave() };
        self.tell(Phase::Finished, None, None)?;
        let mut summary = self.summary(&evaluation);
        let folder = self.folder.clone();
        let desk = self.desk.finish()?;
        summary.seconds.environment = desk.actors.environment;
        summary.seconds.inference = desk.actors.inference;
        summary.seconds.transport = desk.actors.transport;
        summary.seconds.log = desk.log;
        for file in protocol::log::log_files(&folder.log())? {
            summary.log.files += 1;
            summary.log.bytes += fs::metadata(&file.path)?.len();
        }
        let text = serde_json::to_string_pretty(&summary)? + "\n";
        let (path, unfinished) =
            (folder.summary_file(), folder.summary_file().with_extension("unfinished"));
        fs::write(&unfinished, text)
            .and_then(|()| fs::rename(&unfinished, &path))
            .with_context(|| format!("summary {}", path.display()))
    }

    fn summary(&self, evaluation: &[Encoded]) -> Summary {
        let state = &self.state;
        let reward_update = self.progress.reward_update.clone().unwrap_or_default();
        let reached = evaluation.iter().filter(|encoded| encoded.trajectory.success).count();
        Summary {
            task: self.config.task.name().to_owned(),
            method: self.config.method,
            preset: self.config.preset.clone(),
            seed: self.config.seed,
            actors: self.config.resources.actors,
            env_steps: state.environment_steps,
            episodes: state.episodes,
            iterations: state.iteration,
            success_rate: state.success_rate(),
            evaluation: Evaluation {
                episodes: evaluation.len() as u64,
                success_rate: reached as f64 / evaluation.len().max(1) as f64,
            },
            wall_s: state.wall_s,
            steps_per_s: state.environment_steps as f64 / state.wall_s.max(1e-9),
            policy_sha256: weights::sha256([&state.parameters[..]]),
            proximity_sha256: reward_update.weights_sha256,
            log: Log { files: 0, trajectories: state.episodes + evaluation.len() as u64, bytes: 0 },
            seconds: Seconds {
                rollout: self.seconds.rollout,
                scoring: self.seconds.scoring,
                policy_update: self.seconds.policy_update,
                reward_update: self.seconds.reward_update,
                ..Seconds::default()
            },
        }
    }
}
