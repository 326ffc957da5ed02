//! The shape of a policy, as a run's configuration says it.

use serde::{Deserialize, Serialize};

use crate::encoder::CellsArchitecture;

/// Shape of the policy.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PolicyConfig {
    /// Output channels of the convolutions, for grid tasks.
    pub convolution_channels: Vec<usize>,
    /// Side of the convolutions' windows.
    pub convolution_kernel: usize,
    /// Side of the squares pooled behind the first convolution.
    pub pool: usize,
    /// Numbers the encoder makes of a grid.
    pub features: usize,
    /// Hidden layers of actor and critic, for vector tasks.
    pub hidden: Vec<usize>,
    /// What follows each hidden layer.
    pub activation: PolicyActivation,
    /// How continuous actions are drawn.
    pub distribution: ActionDistribution,
    /// Whether actor and critic share the encoder, for grid tasks.
    pub shared_trunk: bool,
    /// Whether observations are shifted and scaled by their running moments, for vector tasks.
    pub normalize_observations: bool,
}

impl PolicyConfig {
    /// The encoder of grids.
    pub fn encoder(&self) -> CellsArchitecture {
        CellsArchitecture {
            channels: self.convolution_channels.clone(),
            kernel: self.convolution_kernel,
            pool: self.pool,
            features: self.features,
        }
    }

    /// Whether continuous actions are squashed.
    pub fn is_squashed(&self) -> bool {
        self.distribution == ActionDistribution::SquashedGaussian
    }
}

/// What follows the hidden layers of a policy.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PolicyActivation {
    /// The hyperbolic tangent.
    Tanh,
    /// The larger of the sum and zero.
    Relu,
}

/// How continuous actions are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ActionDistribution {
    /// Normal, with standard deviations that are parameters of their own.
    Gaussian,
    /// The hyperbolic tangent of normal numbers, whose standard deviations depend on the observation.
    SquashedGaussian,
}
