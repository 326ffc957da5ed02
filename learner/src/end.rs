//! How a run ends: evaluation, last checkpoint, `summary.json`.

use std::fs;

use anyhow::Result;
use protocol::messages::Phase;
use protocol::trajectory::{Encoded, Source};
use run::origin::Demonstrations;
use run::summary::{EvaluationFigures, LogFigures, Summary};
use run::time_to_success::TimeToSuccess;

use crate::desk::Order;
use crate::ledger::{LanePlan, LeaseLedger};
use crate::trainer::Trainer;

impl Trainer {
    /// Ends a run that was stopped: saves what it has learned.
    pub(crate) fn leave(mut self) -> Result<()> {
        if self.state.iteration > 0 {
            self.save()?;
        }
        self.desk.stop()
    }

    /// Ends a run that was trained to its end.
    pub(crate) fn conclude(mut self) -> Result<()> {
        self.save()?;
        let Some(evaluation) = self.evaluate()? else { return self.leave() };
        self.tell(Phase::Finished, None, None)?;
        let mut summary = self.summary(&evaluation);
        let folder = self.folder.clone();
        summary.seconds.log = self.desk.finish()?;
        summary.time_to_success = TimeToSuccess::of_run(&folder)?;
        summary.builds = mcap_log::recorded_builds(&folder.log())?;
        for file in mcap_log::log_files(&folder.log())? {
            summary.log.files += 1;
            summary.log.bytes += fs::metadata(&file.path)?.len();
        }
        Ok(summary.save(&folder)?)
    }

    /// Runs evaluation episodes with the final policy; returns `None` if a stop is requested first. Their bytes
    /// are kept in the log only.
    fn evaluate(&mut self) -> Result<Option<Vec<Encoded>>> {
        self.tell(Phase::Evaluating, None, None)?;
        let episodes = self.config.evaluation.episodes;
        if episodes == 0 {
            return Ok(Some(Vec::new()));
        }
        let plan = |episodes_owed| LanePlan { first_episode: 0, steps_owed: 0, episodes_owed };
        let plans = self.config.rollout.spread(episodes).into_iter().map(plan).collect();
        let version = self.state.iteration;
        let rollout = LeaseLedger::open(Source::Evaluation, version, version, plans);
        self.desk.order(Order::Open(rollout))?;
        Ok(self.rolled_out()?.map(|rolled_out| rolled_out.trajectories))
    }

    fn summary(&self, evaluation: &[Encoded]) -> Summary {
        let state = &self.state;
        let reward_update = self.progress.reward_update.clone().unwrap_or_default();
        let mean = |sum: f64| (!evaluation.is_empty()).then(|| sum / evaluation.len() as f64);
        let reached = evaluation.iter().filter(|encoded| encoded.trajectory.success).count();
        let returns = evaluation.iter().map(|encoded| encoded.trajectory.environment_return());
        let tells_success = self.config.task.tells_success;
        Summary {
            task: self.config.task.name.clone(),
            method: self.config.method.clone(),
            preset: self.config.preset.clone(),
            seed: self.config.seed,
            actors: self.config.resources.actors,
            environment_steps: state.environment_steps,
            episodes: state.episodes,
            iterations: state.iteration,
            success_rate: self.success_rate(),
            evaluation: EvaluationFigures {
                episodes: evaluation.len() as u64,
                success_rate: mean(reached as f64).filter(|_| tells_success),
                mean_return: mean(returns.sum()),
            },
            wall_s: state.wall_s,
            processor_s: state.processor_s,
            time_to_success: Vec::new(),
            steps_per_s: state.environment_steps as f64 / state.wall_s.max(1e-9),
            policy_sha256: state.policy.weights(state.iteration).sha256(),
            reward_model_sha256: reward_update.weights_sha256,
            builds: Vec::new(),
            // A trained run is finished, even if its demonstrations have since been removed.
            demonstrations: Demonstrations::of_run(&self.folder, &self.config).unwrap_or_default(),
            log: LogFigures {
                trajectories: state.episodes + evaluation.len() as u64,
                ..LogFigures::default()
            },
            seconds: self.seconds,
        }
    }
}
