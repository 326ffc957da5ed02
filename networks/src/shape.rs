//! Shapes of networks, as a configuration gives them (paper, Appendix G.2).

use protocol::encoder::CellsArchitecture;
use protocol::policy::{PolicyActivation, PolicyConfig};
use protocol::task::ObservationSpec;

use crate::initialization::Initialization;
use crate::layer::activation::Activation;

/// Architecture of the policy and its value function.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PolicyArchitecture {
    /// Encoder of cell observations.
    pub cells: CellsArchitecture,
    /// Sizes of the hidden layers over vector observations.
    pub hidden: Vec<usize>,
    /// Activation after each hidden layer.
    pub activation: Activation,
    /// Whether actor and critic share the encoder of cell observations.
    pub shared_trunk: bool,
    /// Whether continuous actions are squashed, with standard deviations that depend on the observation.
    pub squashed: bool,
    /// Number of observations in a row: one, or two for an inverse dynamics model.
    pub frames: usize,
}

impl Default for PolicyArchitecture {
    fn default() -> Self {
        let cells = CellsArchitecture::default();
        let activation = Activation::Tanh;
        Self {
            cells,
            hidden: vec![256, 256],
            activation,
            shared_trunk: true,
            squashed: false,
            frames: 1,
        }
    }
}

/// Architecture of a proximity function or a discriminator.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RewardArchitecture {
    /// Encoder of cell observations.
    pub cells: CellsArchitecture,
    /// Sizes of the hidden layers, after the encoder or over the vector.
    pub hidden: Vec<usize>,
    /// Activation after each hidden layer.
    pub activation: Activation,
}

impl Default for RewardArchitecture {
    fn default() -> Self {
        let cells = CellsArchitecture::default();
        Self { cells, hidden: vec![64, 64], activation: Activation::Tanh }
    }
}

impl RewardArchitecture {
    /// Returns the shape of a network of this architecture with one output, over rows of `frames` observations and
    /// `extra_inputs` further numbers.
    pub fn network_shape(
        &self,
        observation: ObservationSpec,
        frames: usize,
        extra_inputs: usize,
    ) -> NetworkShape {
        NetworkShape {
            observation,
            frames,
            extra_inputs,
            cells: self.cells.clone(),
            hidden: self.hidden.clone(),
            activation: self.activation,
            hidden_initialization: Initialization::FanIn,
            heads: vec![Head { outputs: 1, initialization: Initialization::FanIn }],
        }
    }
}

/// Everything that determines a network except its parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct NetworkShape {
    /// Kind and size of one observation.
    pub observation: ObservationSpec,
    /// Number of consecutive observations in a row: one, or two for a transition.
    pub frames: usize,
    /// Number of further inputs in a row, such as those of an action.
    pub extra_inputs: usize,
    /// Encoder of cell observations; unused for vectors.
    pub cells: CellsArchitecture,
    /// Sizes of the hidden layers, after the encoder or over the vector.
    pub hidden: Vec<usize>,
    /// Activation after each hidden layer.
    pub activation: Activation,
    /// Initialization of the hidden layers. The encoder is always initialized by fan-in.
    pub hidden_initialization: Initialization,
    /// The linear outputs, one head after another.
    pub heads: Vec<Head>,
}

/// A linear output.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Head {
    /// Number of outputs.
    pub outputs: usize,
    /// Initialization of the head.
    pub initialization: Initialization,
}

impl From<&PolicyConfig> for PolicyArchitecture {
    fn from(config: &PolicyConfig) -> Self {
        PolicyArchitecture {
            cells: config.encoder(),
            hidden: config.hidden.clone(),
            activation: match config.activation {
                PolicyActivation::Tanh => Activation::Tanh,
                PolicyActivation::Relu => Activation::Relu,
            },
            shared_trunk: config.shared_trunk,
            squashed: config.is_squashed(),
            frames: 1,
        }
    }
}
