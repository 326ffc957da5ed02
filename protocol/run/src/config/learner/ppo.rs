//! Proximal policy optimization on the rewards of the reward model.

use protocol::Error;
use protocol::error::within;
use serde::{Deserialize, Serialize};

use super::LearnerRules;
use crate::config::RunConfig;
use crate::config::estimate::{Memory, Work};
use crate::learning_rate::LearningRate;

/// Proximal policy optimization.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PpoConfig {
    /// Learning rate of the first iteration.
    pub learning_rate: f64,
    /// Whether it falls linearly to 0.
    pub learning_rate_decay: bool,
    /// Environment steps over which it falls; 0 means the steps of the run.
    pub decay_steps: u64,
    /// Adam's epsilon.
    pub adam_epsilon: f64,
    /// Discount factor.
    pub gamma: f64,
    /// Lambda of generalized advantage estimation.
    pub gae_lambda: f64,
    /// Clip range of the probability ratio.
    pub clip: f64,
    /// Clip range of the value; 0 leaves values unclipped.
    pub value_clip: f64,
    /// Weight of the value loss (which itself has the factor 1/2).
    pub value_coefficient: f64,
    /// Weight of the entropy bonus.
    pub entropy_coefficient: f64,
    /// Passes over a batch.
    pub epochs: u64,
    /// Approximate KL divergence from the policy that acted, averaged over a pass, above which no
    /// further pass follows; 0 never stops early.
    pub target_kl: f64,
    /// Minibatches per pass.
    pub minibatches: u64,
    /// Gradient norm above which gradients are clipped.
    pub max_gradient_norm: f64,
    /// Whether an episode truncated at the horizon is bootstrapped with the value of its last state.
    pub bootstrap_truncated: bool,
    /// Whether rewards are divided by the running standard deviation of the discounted return.
    pub normalize_rewards: bool,
}

pub(super) struct Ppo;

impl LearnerRules for Ppo {
    fn name(&self) -> &'static str {
        "ppo"
    }

    fn is_rewarded(&self) -> bool {
        true
    }

    fn imitates(&self) -> bool {
        false
    }

    fn tables(&self) -> &'static [&'static str] {
        &["ppo"]
    }

    fn reads(&self, _config: &RunConfig, table: &str, _key: &str) -> bool {
        table == "ppo"
    }

    fn check(&self, config: &RunConfig) -> Result<(), Error> {
        let (minibatches, most) = (config.ppo.minibatches, config.iteration_steps() / 2);
        let (lanes, lane_steps) = (config.rollout.lanes, config.rollout.lane_steps);
        let expected = format!(
            "at most {most}, half the steps of an iteration, with rollout.lanes = {lanes} and \
             rollout.lane_steps = {lane_steps}"
        );
        within("ppo.minibatches", minibatches <= most, &expected, minibatches)
    }

    /// Requires a step for each minibatch in the shortest iteration. A lane ends an iteration at the end of an
    /// episode, so it can run over by `horizon - 1` steps; its next iteration is then that much shorter.
    fn check_learning(&self, config: &RunConfig) -> Result<(), Error> {
        let horizon = u64::from(config.task.spec().horizon_steps);
        let (lanes, lane_steps) = (config.rollout.lanes, config.rollout.lane_steps);
        let least = lanes.saturating_mul((lane_steps + 1).saturating_sub(horizon));
        let expected = format!(
            "at most the {least} steps that an iteration has at least, with rollout.lanes = {lanes} \
             and rollout.lane_steps = {lane_steps}"
        );
        let minibatches = config.ppo.minibatches;
        within("ppo.minibatches", minibatches <= least, &expected, minibatches)
    }

    fn learning_rate(&self, config: &RunConfig) -> LearningRate {
        let PpoConfig { learning_rate, learning_rate_decay, decay_steps, .. } = config.ppo;
        config.learning_rate(learning_rate, learning_rate_decay, decay_steps)
    }

    fn memory(&self, config: &RunConfig) -> Memory {
        let minibatch = config.iteration_steps() as f64 / config.ppo.minibatches as f64;
        Memory { minibatch, ..Memory::default() }
    }

    fn work(&self, config: &RunConfig) -> Work {
        let iterations = self.iterations(config) as f64;
        let (epochs, taken) = (config.ppo.epochs as f64, config.iteration_steps() as f64);
        Work {
            gradient_steps: iterations * epochs * config.ppo.minibatches as f64,
            row_passes: iterations * taken * (epochs + 1.0),
        }
    }
}
