//! A Q-function of continuous actions, with its target network.

use nalgebra::DMatrix;
use networks::{
    Activation, Batch, Head, Initialization, Network, NetworkShape, Prepared, Shard,
    ShardedTrainer, evaluate,
};
use protocol::seed::{self, Purpose};
use protocol::tensors::Tensors;
use run::config::{RunConfig, SqilConfig};

/// Number of rows in a shard. Changing this changes the order of sums, and thus the results of runs.
const SHARD_ROWS: usize = 64;

/// Adam's epsilon in the soft actor-critic; PyTorch's default.
pub(super) const ADAM_EPSILON: f64 = 1e-8;

/// A Q-function.
pub(super) struct QFunction {
    network: Network,
    action_len: usize,
    parameters: Vec<f32>,
    target_parameters: Vec<f32>,
    trainer: ShardedTrainer<Network>,
    prepared: Prepared,
    prepared_target: Prepared,
}

impl QFunction {
    /// Creates the first or second Q-function of a run. For grid observations it has an encoder like the policy's.
    pub(super) fn new(
        number: u64,
        config: &RunConfig,
        own: &SqilConfig,
        action_len: usize,
    ) -> Self {
        let network = Network::new(NetworkShape {
            observation: config.task.observation,
            frames: 1,
            extra_inputs: action_len,
            cells: config.policy.encoder(),
            hidden: own.hidden.clone(),
            activation: Activation::Relu,
            hidden_initialization: Initialization::FanIn,
            heads: vec![Head { outputs: 1, initialization: Initialization::FanIn }],
        });
        let mut stream = seed::stream(config.seed, Purpose::QWeights, number, 0);
        let parameters = network.initial_parameters(&mut stream);
        QFunction {
            action_len,
            target_parameters: parameters.clone(),
            trainer: ShardedTrainer::new(parameters.len(), ADAM_EPSILON, f64::INFINITY),
            prepared: network.prepare(&parameters),
            prepared_target: network.prepare(&parameters),
            parameters,
            network,
        }
    }

    /// Returns the target network's values of observations and, as extra inputs, actions.
    pub(super) fn target_values(&self, batch: Batch<'_>) -> Vec<f32> {
        evaluate(&self.network, &self.prepared_target, batch, SHARD_ROWS, |shard| {
            let Shard { network, prepared, batch, workspace, .. } = shard;
            network.forward(prepared, batch, workspace).as_slice().to_vec()
        })
    }

    /// Returns values, and their gradients with respect to the numbers of the actions.
    pub(super) fn action_gradients(&self, batch: Batch<'_>) -> (Vec<f32>, Vec<f32>) {
        let len = self.action_len;
        let rows = evaluate(&self.network, &self.prepared, batch, SHARD_ROWS, |shard| {
            let Shard { network, prepared, batch, workspace, .. } = shard;
            let values = network.forward(prepared, batch, workspace).clone();
            let ones = DMatrix::from_element(1, values.ncols(), 1.0);
            let gradients = network.input_gradient(prepared, workspace, &ones);
            let own = gradients.rows(gradients.nrows() - len, len);
            let own = own.column_iter().map(|column| column.iter().copied().collect::<Vec<f32>>());
            values.iter().copied().zip(own).collect()
        });
        let (values, gradients): (Vec<_>, Vec<_>) = rows.into_iter().unzip();
        (values, gradients.concat())
    }

    /// Fits the function to `targets`; returns half the mean squared error before the step.
    pub(super) fn fit(&mut self, batch: Batch<'_>, targets: &[f32], learning_rate: f64) -> f64 {
        let weight = 1.0 / targets.len() as f32;
        let QFunction { network, trainer, parameters, prepared, .. } = self;
        let step =
            trainer.step(network, parameters, batch, SHARD_ROWS, learning_rate, |shard, sum| {
                let Shard { network, prepared, batch, rows, workspace } = shard;
                let values = network.forward(prepared, batch, workspace);
                let errors =
                    values.iter().zip(&targets[rows]).map(|(value, target)| value - target);
                let errors: Vec<f32> = errors.collect();
                let gradients = errors.iter().map(|error| weight * error);
                let gradients = DMatrix::from_iterator(1, errors.len(), gradients);
                network.backward(prepared, batch, workspace, &gradients, sum);
                errors.iter().map(|error| f64::from(error * error)).sum::<f64>()
            });
        network.prepare_into(parameters, prepared);
        0.5 * f64::from(weight) * step.terms
    }

    /// Moves the target network towards the Q-function.
    pub(super) fn update_targets(&mut self, rate: f64) {
        super::polyak_update(&mut self.target_parameters, &self.parameters, rate);
        self.network.prepare_into(&self.target_parameters, &mut self.prepared_target);
    }

    /// Adds everything carried from one update to the next.
    pub(super) fn save(&self, name: &str, tensors: &mut Tensors) {
        self.trainer.save(&format!("{name}.adam"), tensors);
        tensors.put_f32(&format!("{name}.parameters"), self.parameters.iter().copied());
        tensors.put_f32(&format!("{name}.targets"), self.target_parameters.iter().copied());
    }

    /// Restores what [`QFunction::save`] added.
    pub(super) fn restore(&mut self, name: &str, tensors: &Tensors) -> Result<(), String> {
        self.trainer.restore(&format!("{name}.adam"), tensors)?;
        let count = self.parameters.len();
        self.parameters = tensors.exactly(&format!("{name}.parameters"), count, Tensors::f32)?;
        self.target_parameters =
            tensors.exactly(&format!("{name}.targets"), count, Tensors::f32)?;
        self.network.prepare_into(&self.parameters, &mut self.prepared);
        self.network.prepare_into(&self.target_parameters, &mut self.prepared_target);
        Ok(())
    }
}
