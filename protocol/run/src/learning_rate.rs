//! Learning rates of the policy and of the reward model over a run.

use crate::config::{RewardConfig, RunConfig};

/// A learning rate that is constant or falls linearly to 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LearningRate {
    /// Rate in the first iteration.
    pub first: f64,
    /// Iterations until it is 0; `None` if it is constant.
    pub iterations: Option<u64>,
}

impl LearningRate {
    /// Returns the rate in an iteration.
    pub fn at(&self, iteration: u64) -> f64 {
        let Some(iterations) = self.iterations else { return self.first };
        self.first * (1.0 - iteration as f64 / iterations as f64).max(0.0)
    }
}

impl RunConfig {
    /// Returns the learning rate of the policy, which every learner has in its own table.
    pub fn policy_learning_rate(&self) -> LearningRate {
        self.learner.learning_rate(self)
    }

    /// Returns the learning rate of the reward model.
    pub fn reward_learning_rate(&self) -> LearningRate {
        let RewardConfig { learning_rate, learning_rate_decay, decay_steps, .. } = self.reward;
        self.learning_rate(learning_rate, learning_rate_decay, decay_steps)
    }

    /// Returns a rate that is constant or, with `decay`, falls over `decay_steps` steps; 0 means the steps of the run.
    pub(crate) fn learning_rate(&self, first: f64, decay: bool, decay_steps: u64) -> LearningRate {
        let steps = if decay_steps == 0 { self.steps } else { decay_steps };
        LearningRate { first, iterations: decay.then(|| steps.div_ceil(self.iteration_steps())) }
    }
}
