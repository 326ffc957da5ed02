//! Behavioral cloning from observation, with actions that an inverse dynamics model infers.

use protocol::Error;
use protocol::encoder::CellsArchitecture;
use protocol::error::within;
use serde::{Deserialize, Serialize};

use super::LearnerRules;
use super::bc::{check_deviations, cloned_rows, cloning_rate};
use crate::config::RunConfig;
use crate::config::check::positive;
use crate::config::estimate::{Memory, Work};
use crate::learning_rate::LearningRate;

/// The inverse dynamics model of behavioral cloning from observation: it infers which action led
/// from one observation to the next.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InverseDynamicsConfig {
    /// Output channels of the convolutions, for grid tasks.
    pub convolution_channels: Vec<usize>,
    /// Kernel size of the convolutions.
    pub convolution_kernel: usize,
    /// Side of the squares that are max-pooled after the first convolution.
    pub pool: usize,
    /// Features that the encoder outputs for a grid.
    pub features: usize,
    /// Widths of the hidden layers.
    pub hidden: Vec<usize>,
    /// Adam's learning rate.
    pub learning_rate: f64,
    /// Transitions in a minibatch.
    pub batch: usize,
    /// Transitions of the agent sampled for training in each iteration.
    pub samples: usize,
    /// Capacity of the replay buffer in transitions; the newest are kept.
    pub experience: usize,
    /// Environment steps of the untrained policy, which acts at random, before actions are inferred.
    pub exploration_steps: u64,
}

impl InverseDynamicsConfig {
    /// Returns the encoder of grids.
    pub fn encoder(&self) -> CellsArchitecture {
        CellsArchitecture {
            channels: self.convolution_channels.clone(),
            kernel: self.convolution_kernel,
            pool: self.pool,
            features: self.features,
        }
    }

    pub(in crate::config) fn check(&self) -> Result<(), Error> {
        positive("inverse_dynamics.learning_rate", self.learning_rate)?;
        within("inverse_dynamics.features", self.features >= 1, "at least 1", self.features)?;
        let (batch, samples) = (self.batch, self.samples);
        within("inverse_dynamics.batch", batch >= 1, "at least 1", batch)?;
        let expected = format!("at least inverse_dynamics.batch = {batch}");
        within("inverse_dynamics.samples", samples >= batch, &expected, samples)?;
        let kept = self.experience;
        let expected = format!("at least inverse_dynamics.samples = {samples}");
        within("inverse_dynamics.experience", kept >= samples, &expected, kept)
    }
}

pub(super) struct Bco;

impl LearnerRules for Bco {
    fn name(&self) -> &'static str {
        "bco"
    }

    fn replays(&self) -> bool {
        true
    }

    fn tables(&self) -> &'static [&'static str] {
        &["cloning", "inverse_dynamics"]
    }

    fn reads(&self, _config: &RunConfig, table: &str, key: &str) -> bool {
        match table {
            "cloning" => !["validation", "patience"].contains(&key),
            table => table == "inverse_dynamics",
        }
    }

    fn check_learning(&self, config: &RunConfig) -> Result<(), Error> {
        let (steps, found) = (config.steps, config.inverse_dynamics().exploration_steps);
        let expected = format!("at most steps = {steps}");
        within("inverse_dynamics.exploration_steps", found <= steps, &expected, found)?;
        check_deviations(config)
    }

    fn learning_rate(&self, config: &RunConfig) -> LearningRate {
        cloning_rate(config)
    }

    fn memory(&self, config: &RunConfig) -> Memory {
        let kept = config.inverse_dynamics().experience;
        Memory { minibatch: cloned_rows(config), copies: 4.0, kept }
    }

    fn work(&self, config: &RunConfig) -> Work {
        let (rows, iterations) = (config.demonstration_rows(), self.iterations(config) as f64);
        let (cloning, inverse) = (config.cloning(), config.inverse_dynamics());
        let (samples, epochs) = (inverse.samples as f64, cloning.epochs as f64);
        let inferred = (samples / inverse.batch as f64).ceil();
        let cloned = epochs * (rows / cloning.batch as f64).ceil();
        Work {
            gradient_steps: iterations * (inferred + cloned),
            row_passes: iterations * (samples + rows * (1.0 + epochs)),
        }
    }
}
