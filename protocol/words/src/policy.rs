//! The architecture of a policy, as given by a run's configuration.

use serde::{Deserialize, Serialize};

use crate::encoder::CellsArchitecture;

/// Least standard deviation, in the demonstrations, of a number of the observation that networks see scaled. The unit
/// is that of the number: meters, radians, or either per second. Smaller numbers are not scaled.
pub const LEAST_SCALED_DEVIATION: f64 = 0.01;

/// Architecture of the policy network.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PolicyConfig {
    /// Output channels of the convolutions, for grid tasks.
    pub convolution_channels: Vec<usize>,
    /// Kernel size of the convolutions.
    pub convolution_kernel: usize,
    /// Window size of the pooling after the first convolution.
    pub pool: usize,
    /// Number of features that the encoder outputs for a grid.
    pub features: usize,
    /// Sizes of the hidden layers of actor and critic, for vector tasks.
    pub hidden: Vec<usize>,
    /// Activation after each hidden layer.
    pub activation: PolicyActivation,
    /// Distribution of continuous actions.
    pub distribution: ActionDistribution,
    /// Whether actor and critic share the encoder, for grid tasks.
    pub shared_trunk: bool,
    /// Whether observations are normalized, for vector tasks: by running moments with PPO, by those of the
    /// demonstrations with learners that imitate these themselves.
    pub normalize_observations: bool,
}

impl PolicyConfig {
    /// Returns the architecture of the encoder of grids.
    pub fn encoder(&self) -> CellsArchitecture {
        CellsArchitecture {
            channels: self.convolution_channels.clone(),
            kernel: self.convolution_kernel,
            pool: self.pool,
            features: self.features,
        }
    }

    /// Returns whether continuous actions are squashed.
    pub fn is_squashed(&self) -> bool {
        self.distribution == ActionDistribution::SquashedGaussian
    }
}

/// Activation of the hidden layers of a policy.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PolicyActivation {
    /// The hyperbolic tangent.
    Tanh,
    /// The rectified linear unit, ReLU.
    Relu,
}

/// Distribution of continuous actions.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ActionDistribution {
    /// Normal, with standard deviations that are parameters independent of the observation.
    Gaussian,
    /// The hyperbolic tangent of a normal sample whose standard deviations depend on the observation.
    SquashedGaussian,
}
