//! Behavioral cloning: supervised learning of the expert's actions, without environment steps.

use protocol::Error;
use protocol::error::within;
use serde::{Deserialize, Serialize};

use super::LearnerRules;
use crate::config::RunConfig;
use crate::config::check::positive;
use crate::config::estimate::{Memory, Work};
use crate::learning_rate::LearningRate;

/// Supervised learning of a policy from observations and actions, by maximum likelihood.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CloningConfig {
    /// Adam's learning rate.
    pub learning_rate: f64,
    /// Adam's epsilon.
    pub adam_epsilon: f64,
    /// Gradient norm above which gradients are clipped.
    pub max_gradient_norm: f64,
    /// Observation-action pairs in a minibatch.
    pub batch: usize,
    /// In behavioral cloning, the largest number of passes over the training part; in behavioral
    /// cloning from observation, the passes per iteration.
    pub epochs: u64,
    /// Whether the standard deviations of continuous actions are fitted, too. Otherwise they stay at one, and the
    /// loss is half the squared error of the means plus a constant. Those of squashed actions are always fitted.
    pub deviations: bool,
    /// Share of the demonstrations held out, in [0, 1), rounded down to whole ones; if none is held
    /// out, behavioral cloning trains for all epochs.
    pub validation: f64,
    /// Passes without a lower loss on the held-out demonstrations after which behavioral cloning ends.
    /// It keeps the weights with the lowest loss or, if nothing is held out, those of the last pass.
    pub patience: u64,
}

impl CloningConfig {
    pub(in crate::config) fn check(&self) -> Result<(), Error> {
        positive("cloning.learning_rate", self.learning_rate)?;
        positive("cloning.adam_epsilon", self.adam_epsilon)?;
        positive("cloning.max_gradient_norm", self.max_gradient_norm)?;
        within("cloning.batch", self.batch >= 1, "at least 1", self.batch)?;
        within("cloning.epochs", self.epochs >= 1, "at least 1", self.epochs)?;
        let held_out = self.validation;
        within(
            "cloning.validation",
            (0.0..1.0).contains(&held_out),
            "0 or above, below 1",
            held_out,
        )?;
        within("cloning.patience", self.patience >= 1, "at least 1", self.patience)
    }
}

pub(super) struct Bc;

impl LearnerRules for Bc {
    fn name(&self) -> &'static str {
        "bc"
    }

    fn needs_expert_actions(&self) -> bool {
        true
    }

    fn tables(&self) -> &'static [&'static str] {
        &["cloning"]
    }

    fn reads(&self, _config: &RunConfig, table: &str, _key: &str) -> bool {
        table == "cloning"
    }

    fn check_learning(&self, config: &RunConfig) -> Result<(), Error> {
        check_deviations(config)
    }

    fn learning_rate(&self, config: &RunConfig) -> LearningRate {
        cloning_rate(config)
    }

    fn acts(&self) -> bool {
        false
    }

    /// Counts one iteration for each pass.
    fn iterations(&self, config: &RunConfig) -> u64 {
        config.cloning().epochs
    }

    fn memory(&self, config: &RunConfig) -> Memory {
        Memory { minibatch: cloned_rows(config), copies: 2.0, ..Memory::default() }
    }

    fn work(&self, config: &RunConfig) -> Work {
        let (rows, iterations) = (config.demonstration_rows(), self.iterations(config) as f64);
        Work {
            gradient_steps: iterations * (rows / config.cloning().batch as f64).ceil(),
            row_passes: iterations * rows,
        }
    }
}

/// Requires `cloning.deviations` for squashed actions: a network outputs their standard deviations,
/// so these cannot stay at one.
pub(super) fn check_deviations(config: &RunConfig) -> Result<(), Error> {
    let squashed = config.policy.is_squashed() && !config.has_discrete_actions();
    let fitted = config.cloning().deviations;
    let expected = "true with policy.distribution = squashed-gaussian";
    within("cloning.deviations", fitted || !squashed, expected, fitted)
}

pub(super) fn cloning_rate(config: &RunConfig) -> LearningRate {
    config.learning_rate(config.cloning().learning_rate, false, 0)
}

/// Returns the rows of a minibatch in cloning.
pub(super) fn cloned_rows(config: &RunConfig) -> f64 {
    (config.cloning().batch as f64).min(config.demonstration_rows())
}
