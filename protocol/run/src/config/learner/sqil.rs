//! Soft Q imitation learning: the expert's transitions earn 1, the agent's 0.

use protocol::Error;
use protocol::error::within;
use serde::{Deserialize, Serialize};

use super::LearnerRules;
use crate::config::RunConfig;
use crate::config::check::positive;
use crate::config::estimate::{Memory, Work};
use crate::learning_rate::LearningRate;

/// Soft Q imitation learning: soft Q-learning for discrete actions, a soft actor-critic for
/// continuous ones (paper, Appendix F). Soft Q-learning has the optimizer's settings of the table `ppo`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SqilConfig {
    /// Widths of the hidden layers of the Q-functions, for continuous actions. Over a grid they
    /// follow an encoder like the policy's.
    pub hidden: Vec<usize>,
    /// Adam's learning rate in the first iteration; it falls linearly to 0 over the run.
    pub learning_rate: f64,
    /// Discount factor.
    pub gamma: f64,
    /// What follows the goal of a demonstration. If the task does not tell success, the goal is its last state.
    pub expert_after_goal: AfterGoal,
    /// What follows the goal if the agent's episode ends there. Anything but `continues` rewards or punishes success.
    /// If the task does not tell success, an episode that the environment terminates has failed: a value of 0 follows.
    pub agent_after_goal: AfterGoal,
    /// Rate at which the target functions follow the Q-functions at each update (Polyak averaging).
    pub target_rate: f64,
    /// Weight of the entropy; the initial one if it is tuned.
    pub temperature: f64,
    /// Whether the temperature is tuned towards an entropy of minus the number of action dimensions.
    pub tune_temperature: bool,
    /// Transitions of the expert in a minibatch, and as many of the agent.
    pub batch: usize,
    /// Updates per environment step.
    pub updates_per_step: f64,
    /// Capacity of the agent's replay buffer in transitions; the newest are kept.
    pub experience: usize,
    /// Environment steps before the first update.
    pub exploration_steps: u64,
}

/// What a Q-function assumes to follow an episode that ended at the goal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum AfterGoal {
    /// The target function's value of the last observation.
    Continues,
    /// Nothing: a value of 0.
    Terminal,
    /// A state that earns 1 forever: a value of `1 / (1 - gamma)`.
    Absorbing,
}

impl AfterGoal {
    /// Returns the value of what follows; `None` if it is that of the last observation.
    pub fn value(self, gamma: f64) -> Option<f32> {
        match self {
            AfterGoal::Continues => None,
            AfterGoal::Terminal => Some(0.0),
            AfterGoal::Absorbing => Some((1.0 / (1.0 - gamma)) as f32),
        }
    }
}

impl SqilConfig {
    pub(in crate::config) fn check(&self) -> Result<(), Error> {
        positive("sqil.learning_rate", self.learning_rate)?;
        positive("sqil.temperature", self.temperature)?;
        positive("sqil.updates_per_step", self.updates_per_step)?;
        let (gamma, rate) = (self.gamma, self.target_rate);
        within("sqil.gamma", gamma > 0.0 && gamma < 1.0, "above 0 and below 1", gamma)?;
        within("sqil.target_rate", rate > 0.0 && rate <= 1.0, "above 0 and at most 1", rate)?;
        let (batch, kept) = (self.batch, self.experience);
        within("sqil.batch", batch >= 1, "at least 1", batch)?;
        within("sqil.experience", kept >= batch, &format!("at least sqil.batch = {batch}"), kept)
    }
}

pub(super) struct Sqil;

impl LearnerRules for Sqil {
    fn name(&self) -> &'static str {
        "sqil"
    }

    fn needs_expert_actions(&self) -> bool {
        true
    }

    fn replays(&self) -> bool {
        true
    }

    fn tables(&self) -> &'static [&'static str] {
        &["sqil"]
    }

    /// Includes the optimizer's keys of the table `ppo` for discrete actions, where soft Q-learning uses them.
    fn reads(&self, config: &RunConfig, table: &str, key: &str) -> bool {
        let optimizer = ["adam_epsilon", "max_gradient_norm"].contains(&key);
        table == "sqil" || (table == "ppo" && config.has_discrete_actions() && optimizer)
    }

    /// Refuses an action scale: a squashed action lies within [-1, 1], and scaled down it could not reach the expert's.
    fn check(&self, config: &RunConfig) -> Result<(), Error> {
        let scale = config.environment.action_scale();
        within("environment.action_scale", scale.is_empty(), "none for sqil", format!("{scale:?}"))
    }

    fn check_learning(&self, config: &RunConfig) -> Result<(), Error> {
        let (steps, found) = (config.steps, config.sqil().exploration_steps);
        let expected = format!("below steps = {steps}");
        within("sqil.exploration_steps", found < steps, &expected, found)?;
        let rate = config.sqil().updates_per_step;
        let learns = steps.saturating_sub(found) as f64 * rate >= 1.0;
        let expected = "such that there is an update after sqil.exploration_steps";
        within("sqil.updates_per_step", learns, expected, rate)?;
        let squashed = config.has_discrete_actions() || config.policy.is_squashed();
        within("policy.distribution", squashed, "squashed-gaussian for sqil", "gaussian")
    }

    fn learning_rate(&self, config: &RunConfig) -> LearningRate {
        config.learning_rate(config.sqil().learning_rate, true, 0)
    }

    fn memory(&self, config: &RunConfig) -> Memory {
        let sqil = config.sqil();
        Memory { minibatch: 2.0 * sqil.batch as f64, copies: 1.0, kept: sqil.experience }
    }

    fn work(&self, config: &RunConfig) -> Work {
        let sqil = config.sqil();
        let updates = config.steps as f64 * sqil.updates_per_step;
        // Forward passes, and forward and backward passes, through two functions and the policy.
        let rows = 2.0 * sqil.batch as f64 * 5.0;
        Work { gradient_steps: updates * 3.0, row_passes: updates * rows }
    }
}
