//! What a network looks like, as a configuration states it (paper, Appendix G.2).

use protocol::encoder::CellsArchitecture;
use protocol::policy::{PolicyActivation, PolicyConfig};
use protocol::task::ObservationSpec;

use crate::initialization::Initialization;
use crate::layer::activation::Activation;

/// The policy and its value function.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PolicyArchitecture {
    /// Encoder of cell observations.
    pub cells: CellsArchitecture,
    /// Hidden layers over vector observations.
    pub hidden: Vec<usize>,
    /// What follows each hidden layer.
    pub activation: Activation,
    /// Whether actor and critic share the encoder of cell observations.
    pub shared_trunk: bool,
    /// Whether continuous actions are squashed, with standard deviations that depend on the observation.
    pub squashed: bool,
    /// Observations in a row: one, or two for an inverse dynamics model.
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

/// A proximity function or a discriminator.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RewardArchitecture {
    /// Encoder of cell observations.
    pub cells: CellsArchitecture,
    /// Hidden layers, behind the encoder or over the vector.
    pub hidden: Vec<usize>,
    /// What follows each hidden layer.
    pub activation: Activation,
}

impl Default for RewardArchitecture {
    fn default() -> Self {
        let cells = CellsArchitecture::default();
        Self { cells, hidden: vec![64, 64], activation: Activation::Tanh }
    }
}

impl RewardArchitecture {
    /// The network of this architecture with one output, over so many observations and extra inputs
    /// of a row.
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

/// Everything that determines a network but its parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct NetworkShape {
    /// What one observation is.
    pub observation: ObservationSpec,
    /// How many observations a row holds, one after another: one, or two for a transition.
    pub frames: usize,
    /// How many further numbers a row has, such as those of an action.
    pub extra_inputs: usize,
    /// Encoder of cell observations; unused for vectors.
    pub cells: CellsArchitecture,
    /// Hidden layers, behind the encoder or over the vector.
    pub hidden: Vec<usize>,
    /// What follows each hidden layer.
    pub activation: Activation,
    /// First weights of the hidden layers. Those of the encoder are always drawn by fan-in.
    pub hidden_initialization: Initialization,
    /// The linear outputs, one head after another.
    pub heads: Vec<Head>,
}

/// A linear output.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Head {
    /// How many numbers.
    pub outputs: usize,
    /// First weights.
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
