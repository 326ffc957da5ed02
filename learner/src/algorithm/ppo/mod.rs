//! Proximal policy optimization with clipped ratios and values (Table 2; Algorithm 1, line 9).

mod loss;
#[cfg(test)]
mod tests;

use anyhow::Result;
use networks::{ActorCritic, Distribution, Observations, RunningMoments, WindowIndex};
use protocol::messages::Score;
use protocol::seed::{self, Purpose};
use protocol::task::Spec;
use protocol::tensors::Tensors;
use protocol::trajectory::Encoded;
use rand::seq::SliceRandom;
use run::config::PpoConfig;
use run::process::Final;

use crate::advantage::{generalized_advantages, normalize};
use crate::algorithm::policy_trainer::{PolicyTrainer, RowLoss, RowOutput};
use crate::algorithm::ppo::loss::Row;
use crate::algorithm::{Metrics, PolicyLearner, Schedule, Setup};
use crate::batch::RolloutBatch;
use crate::reward_scale::RewardScale;
use crate::state::PolicyState;

/// The learner of PPO: it scales rewards, updates the policy, then updates the observation moments.
pub(super) struct Ppo {
    spec: Spec,
    update: PpoUpdate,
    reward_scale: RewardScale,
}

impl Ppo {
    /// Creates an untrained learner.
    pub(super) fn new(of: Setup<'_>) -> Ppo {
        let Setup { config, network, .. } = of;
        let spec = config.task.spec();
        let update = PpoUpdate::new(spec, config.ppo.clone(), network);
        Ppo { spec, update, reward_scale: RewardScale::default() }
    }
}

impl PolicyLearner for Ppo {
    fn update(
        &mut self,
        policy: &mut PolicyState,
        trajectories: &[Encoded],
        scores: &[Score],
        schedule: &Schedule,
    ) -> Result<Metrics> {
        let mut batch = RolloutBatch::new(trajectories, scores, &self.spec)?;
        let PpoConfig { normalize_rewards, gamma, .. } = self.update.config;
        if normalize_rewards {
            batch.scale_rewards(&mut self.reward_scale, trajectories, gamma);
        }
        batch.normalize(&policy.normalizer);
        let metrics = self.update.update(&mut policy.parameters, &batch, schedule)?;
        for encoded in trajectories {
            policy.normalizer.update(encoded.trajectory.observations());
        }
        Ok(metrics)
    }

    fn save(&self, tensors: &mut Tensors) {
        self.update.save(tensors);
        let RunningMoments { mean, variance, count } = self.reward_scale.returns;
        tensors.put_f64("reward_scale", [mean, variance, count]);
    }

    fn restore(&mut self, tensors: &Tensors) -> Result<(), String> {
        self.update.restore(tensors)?;
        let returns = tensors.exactly("reward_scale", 3, Tensors::f64)?;
        let returns = RunningMoments { mean: returns[0], variance: returns[1], count: returns[2] };
        self.reward_scale = RewardScale { returns };
        Ok(())
    }
}

/// The PPO update of a policy and its value function.
pub struct PpoUpdate {
    spec: Spec,
    config: PpoConfig,
    trainer: PolicyTrainer,
}

/// Targets of the rows of a batch.
struct Targets {
    values: Vec<f32>,
    returns: Vec<f32>,
    advantages: Vec<f32>,
}

impl PpoUpdate {
    /// Creates the update of this network.
    pub fn new(spec: Spec, config: PpoConfig, network: ActorCritic) -> PpoUpdate {
        let trainer = PolicyTrainer::new(network, config.adam_epsilon, config.max_gradient_norm);
        PpoUpdate { spec, config, trainer }
    }

    /// Adds the optimizer's state to `tensors`, as `adam`.
    pub fn save(&self, tensors: &mut Tensors) {
        self.trainer.save("adam", tensors);
    }

    /// Restores what [`PpoUpdate::save`] added.
    fn restore(&mut self, tensors: &Tensors) -> Result<(), String> {
        self.trainer.restore("adam", tensors)
    }

    /// Improves the parameters with a batch: several epochs of minibatches, ended early by an epoch whose
    /// approximate KL divergence exceeds `target_kl`.
    ///
    /// # Errors
    /// [`Final`] at the first minibatch with a loss or gradient that is NaN or infinite.
    pub fn update(
        &mut self,
        parameters: &mut [f32],
        batch: &RolloutBatch,
        schedule: &Schedule,
    ) -> Result<Metrics, Final> {
        // A batch with fewer rows than minibatches has minibatches of one row.
        let size = (batch.len() / self.config.minibatches as usize).max(1);
        let mut rows: Vec<u32> = (0..batch.len() as u32).collect();
        let mut windows = WindowIndex::default();
        let observations = self.trainer.index(&batch.observations, &mut windows);
        let all = Observations::Rows(observations, &rows);
        let targets = self.targets(parameters, batch, all);
        let mut metrics = Metrics::default();
        let mut epochs = 0;
        for epoch in 0..self.config.epochs {
            let Schedule { run_seed, iteration, learning_rate } = *schedule;
            let purpose = Purpose::PolicyMinibatches;
            rows.shuffle(&mut seed::stream(run_seed, purpose, iteration, epoch));
            let minibatches = rows.chunks_exact(size).take(self.config.minibatches as usize);
            let count = minibatches.len() as f64;
            let mut of_epoch = Metrics::default();
            for (number, minibatch) in minibatches.enumerate() {
                let loss = Loss {
                    spec: &self.spec,
                    config: &self.config,
                    distribution: self.trainer.network().distribution(),
                    batch,
                    targets: &targets,
                    weight: 1.0 / minibatch.len() as f32,
                };
                let own =
                    self.trainer.step(parameters, observations, minibatch, &loss, learning_rate);
                own.expect_finite(format_args!("epoch {}, minibatch {}", epoch + 1, number + 1))?;
                of_epoch += own;
            }
            let of_epoch = of_epoch.divided_by(count);
            metrics += of_epoch;
            epochs += 1;
            let target = self.config.target_kl;
            if target > 0.0 && of_epoch.approximate_kl > target {
                break;
            }
        }
        Ok(metrics.divided_by(f64::from(epochs)))
    }

    /// Computes the values of a batch, whose observations are `observations`, under the current policy, and
    /// from them advantages and returns.
    fn targets(
        &mut self,
        parameters: &[f32],
        batch: &RolloutBatch,
        observations: Observations<'_>,
    ) -> Targets {
        let values = self.trainer.values(parameters, observations);
        let bootstrap = self.config.bootstrap_truncated;
        let cut = batch.episodes.iter().filter(|episode| bootstrap && episode.truncated);
        let cut: Vec<&[u8]> = cut.map(|episode| &episode.last_observation[..]).collect();
        let cut = cut.concat();
        let last_values = self.trainer.values(parameters, Observations::Bytes(&cut));
        let mut last_values = last_values.into_iter();
        let (gamma, lambda) = (self.config.gamma as f32, self.config.gae_lambda as f32);
        let (mut advantages, mut returns) = (Vec::new(), Vec::new());
        let mut start = 0;
        for episode in &batch.episodes {
            let last_value = match bootstrap && episode.truncated {
                true => last_values.next().expect("one value per episode that was cut"),
                false => 0.0,
            };
            let rows = start..start + episode.steps;
            let (rewards, values) = (&batch.rewards[rows.clone()], &values[rows]);
            let own = generalized_advantages(rewards, values, last_value, gamma, lambda);
            advantages.extend(own.0);
            returns.extend(own.1);
            start += episode.steps;
        }
        normalize(&mut advantages);
        Targets { values, returns, advantages }
    }
}

/// The loss of a minibatch.
struct Loss<'a> {
    spec: &'a Spec,
    config: &'a PpoConfig,
    distribution: Distribution,
    batch: &'a RolloutBatch,
    targets: &'a Targets,
    /// One over the number of rows of the minibatch.
    weight: f32,
}

impl RowLoss for Loss<'_> {
    const OF_VALUES: bool = true;

    fn of_row(&self, row: usize, output: RowOutput<'_>, gradients: &mut [f32]) -> (Metrics, f32) {
        let bytes = self.spec.action.bytes();
        let row = Row {
            action: &self.batch.actions[row * bytes..(row + 1) * bytes],
            log_probability: self.batch.log_probs[row],
            advantage: self.targets.advantages[row],
            old_value: self.targets.values[row],
            target: self.targets.returns[row],
        };
        row.loss(self.config, self.distribution, self.weight, output, gradients)
    }
}
