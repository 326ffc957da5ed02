//! A Q-function of vector observations and continuous actions, with its target function.

use nalgebra::DMatrix;
use networks::{
    Activation, Adam, Batch as Rows, Head, Initialization, Network, NetworkShape, Prepared,
    Workspace,
};
use protocol::seed::{self, Purpose};
use protocol::task::Spec;
use protocol::tensors::Tensors;
use rayon::ThreadPool;
use rayon::prelude::*;

/// Rows of a shard. Part of what a run means: changing it changes the order of sums.
const SHARD_ROWS: usize = 64;

/// A Q-function.
pub(super) struct QFunction {
    network: Network,
    observation_bytes: usize,
    action_len: usize,
    parameters: Vec<f32>,
    targets: Vec<f32>,
    optimizer: Adam,
    prepared: Prepared,
    prepared_targets: Prepared,
}

/// Rows a Q-function is asked about.
#[derive(Clone, Copy)]
pub(super) struct StateActions<'a> {
    /// Observations, as networks see them.
    pub(super) observations: &'a [u8],
    /// The numbers of the actions.
    pub(super) actions: &'a [f32],
}

impl QFunction {
    /// The first or second Q-function of a run.
    pub(super) fn new(
        number: u64,
        spec: &Spec,
        action_len: usize,
        hidden: &[usize],
        run_seed: u64,
    ) -> Self {
        let network = Network::new(NetworkShape {
            observation: spec.observation,
            frames: 1,
            extra_inputs: action_len,
            cells: networks::CellsArchitecture::default(),
            hidden: hidden.to_vec(),
            activation: Activation::Relu,
            hidden_initialization: Initialization::FanIn,
            heads: vec![Head { outputs: 1, initialization: Initialization::FanIn }],
        });
        let mut stream = seed::stream(run_seed, Purpose::QWeights, number, 0);
        let parameters = network.initial_parameters(&mut stream);
        QFunction {
            observation_bytes: spec.observation.bytes(),
            action_len,
            targets: parameters.clone(),
            optimizer: Adam::new(parameters.len(), 1e-8),
            prepared: network.prepare(&parameters),
            prepared_targets: network.prepare(&parameters),
            parameters,
            network,
        }
    }

    fn shards<'a>(&self, asked: StateActions<'a>) -> impl IndexedParallelIterator<Item = Rows<'a>> {
        let observations = asked.observations.par_chunks(SHARD_ROWS * self.observation_bytes);
        let actions = asked.actions.par_chunks(SHARD_ROWS * self.action_len);
        observations
            .zip(actions)
            .map(|(observations, extra_inputs)| Rows { observations, extra_inputs })
    }

    /// What the target function says.
    pub(super) fn target_values(&self, asked: StateActions<'_>, threads: &ThreadPool) -> Vec<f32> {
        let values = |workspace: &mut Workspace, rows: Rows<'_>| {
            self.network.forward(&self.prepared_targets, rows, workspace).as_slice().to_vec()
        };
        let shards = self.shards(asked).map_init(Workspace::default, values);
        threads.install(|| shards.collect::<Vec<_>>()).concat()
    }

    /// Values, and their gradients with respect to the numbers of the actions.
    pub(super) fn action_gradients(
        &self,
        asked: StateActions<'_>,
        threads: &ThreadPool,
    ) -> (Vec<f32>, Vec<f32>) {
        let gradients = |workspace: &mut Workspace, rows: Rows<'_>| {
            let values = self.network.forward(&self.prepared, rows, workspace).clone();
            let ones = DMatrix::from_element(1, values.ncols(), 1.0);
            let gradients = self.network.input_gradient(&self.prepared, workspace, &ones);
            let first = gradients.nrows() - self.action_len;
            let own = gradients.rows(first, self.action_len).iter().copied().collect::<Vec<f32>>();
            (values.as_slice().to_vec(), own)
        };
        let shards = self.shards(asked).map_init(Workspace::default, gradients);
        let (values, gradients): (Vec<_>, Vec<_>) =
            threads.install(|| shards.collect::<Vec<_>>()).into_iter().unzip();
        (values.concat(), gradients.concat())
    }

    /// Fits the function to `targets`; returns half the mean squared error before.
    pub(super) fn fit(
        &mut self,
        asked: StateActions<'_>,
        targets: &[f32],
        learning_rate: f64,
        threads: &ThreadPool,
    ) -> f64 {
        let weight = 1.0 / targets.len() as f32;
        let of_shard = |workspace: &mut Workspace, (rows, targets): (Rows<'_>, &[f32])| {
            let values = self.network.forward(&self.prepared, rows, workspace);
            let errors: Vec<f32> =
                values.iter().zip(targets).map(|(value, target)| value - target).collect();
            let gradients =
                DMatrix::from_iterator(1, errors.len(), errors.iter().map(|error| weight * error));
            let mut gradient = vec![0.0; self.parameters.len()];
            self.network.backward(&self.prepared, rows, workspace, &gradients, &mut gradient);
            let squares = errors.iter().map(|error| f64::from(error * error));
            (gradient, squares.sum::<f64>())
        };
        let shards = self.shards(asked).zip(targets.par_chunks(SHARD_ROWS));
        let shards = shards.map_init(Workspace::default, of_shard);
        let shards = threads.install(|| shards.collect::<Vec<_>>());
        let mut gradient = vec![0.0; self.parameters.len()];
        let mut squares = 0.0;
        for (own, own_squares) in &shards {
            networks::add(&mut gradient, own);
            squares += own_squares;
        }
        self.optimizer.update(&mut self.parameters, &gradient, learning_rate);
        self.network.prepare_into(&self.parameters, &mut self.prepared);
        0.5 * f64::from(weight) * squares
    }

    /// Moves the target function towards the function.
    pub(super) fn follow(&mut self, rate: f64) {
        super::follow(&mut self.targets, &self.parameters, rate);
        self.network.prepare_into(&self.targets, &mut self.prepared_targets);
    }

    /// Adds everything carried from one update to the next.
    pub(super) fn save(&self, name: &str, tensors: &mut Tensors) {
        self.optimizer.save(&format!("{name}.adam"), tensors);
        tensors.put_f32(&format!("{name}.parameters"), self.parameters.iter().copied());
        tensors.put_f32(&format!("{name}.targets"), self.targets.iter().copied());
    }

    /// Takes over what [`QFunction::save`] added.
    pub(super) fn restore(&mut self, name: &str, tensors: &Tensors) -> Result<(), String> {
        self.optimizer.restore(&format!("{name}.adam"), tensors)?;
        let count = self.parameters.len();
        self.parameters = tensors.exactly(&format!("{name}.parameters"), count, Tensors::f32)?;
        self.targets = tensors.exactly(&format!("{name}.targets"), count, Tensors::f32)?;
        self.network.prepare_into(&self.parameters, &mut self.prepared);
        self.network.prepare_into(&self.targets, &mut self.prepared_targets);
        Ok(())
    }
}
