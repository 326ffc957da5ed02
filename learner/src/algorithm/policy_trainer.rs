//! Gradient steps of a policy on losses that are sums over rows.

use nalgebra::DMatrix;
use networks::{
    ActorCritic, Batch, Indexed, Observations, PreparedPolicy, Shard, ShardedTrainer, WindowIndex,
    evaluate,
};
use protocol::tensors::Tensors;

use crate::algorithm::Metrics;

/// Maximum number of rows in a shard. Changing this changes the order of sums, and thus the results of runs.
const SHARD_ROWS: usize = 128;

/// Minimum number of shards per minibatch, so that two threads can share it.
const SHARDS_MIN: usize = 2;

/// A loss that is a sum over rows.
pub(crate) trait RowLoss: Sync {
    /// Whether the loss depends on the values as well as on the action parameters.
    const OF_VALUES: bool;

    /// Returns the metrics of a row of the batch, given the network's output for it, and the derivative with
    /// respect to the value. Writes the gradient with respect to the action parameters.
    fn of_row(&self, row: usize, output: RowOutput<'_>, gradient: &mut [f32]) -> (Metrics, f32);
}

/// A network's output for one row.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RowOutput<'a> {
    /// Parameters of the action distribution.
    pub(crate) parameters: &'a [f32],
    /// The value; 0 if the loss does not depend on it.
    pub(crate) value: f32,
}

/// A policy network in training; the caller keeps its parameters.
pub(crate) struct PolicyTrainer {
    network: ActorCritic,
    trainer: ShardedTrainer<ActorCritic>,
    prepared: PreparedPolicy,
}

impl PolicyTrainer {
    /// Creates a trainer of a network; gradients are clipped to `max_gradient_norm`.
    pub(crate) fn new(network: ActorCritic, adam_epsilon: f64, max_gradient_norm: f64) -> Self {
        let count = network.parameter_count();
        PolicyTrainer {
            network,
            trainer: ShardedTrainer::new(count, adam_epsilon, max_gradient_norm),
            prepared: PreparedPolicy::default(),
        }
    }

    /// Returns the network.
    pub(crate) fn network(&self) -> &ActorCritic {
        &self.network
    }

    /// Returns the number of observation bytes per row.
    pub(crate) fn row_bytes(&self) -> usize {
        self.network.row_size().observation_bytes
    }

    /// Indexes the windows that are repeated in rows of observations, for several steps on these rows.
    pub(crate) fn index<'a>(
        &self,
        observations: &'a [u8],
        windows: &'a mut WindowIndex,
    ) -> Indexed<'a> {
        self.network.actor().0.index(observations, windows)
    }

    /// Computes the values of rows of observations, in order.
    pub(crate) fn values(
        &mut self,
        parameters: &[f32],
        observations: Observations<'_>,
    ) -> Vec<f32> {
        self.network.prepare_into(parameters, &mut self.prepared);
        let batch = Batch { observations, extra_inputs: &[] };
        evaluate(&self.network, &self.prepared, batch, SHARD_ROWS, |shard| {
            let Shard { network, prepared, batch, workspace, .. } = shard;
            network.values(prepared, batch, workspace).as_slice().to_vec()
        })
    }

    /// Applies `of_row` to the action parameters of rows of observations; returns the results in order.
    pub(crate) fn outputs<T: Send>(
        &mut self,
        parameters: &[f32],
        observations: &[u8],
        of_row: impl Fn(&[f32]) -> T + Sync,
    ) -> Vec<T> {
        self.network.prepare_into(parameters, &mut self.prepared);
        let batch = Batch::new(observations);
        evaluate(&self.network, &self.prepared, batch, SHARD_ROWS, |shard| {
            let Shard { network, prepared, batch, workspace, .. } = shard;
            let outputs = network.act(prepared, batch, workspace);
            outputs.as_slice().chunks_exact(outputs.nrows()).map(&of_row).collect()
        })
    }

    /// Takes one gradient step on a loss over the rows of a minibatch, given by their positions among
    /// `observations`. Returns the sum of their metrics.
    pub(crate) fn step(
        &mut self,
        parameters: &mut [f32],
        observations: Indexed<'_>,
        minibatch: &[u32],
        loss: &impl RowLoss,
        learning_rate: f64,
    ) -> Metrics {
        let shard_rows = SHARD_ROWS.min(minibatch.len().div_ceil(SHARDS_MIN));
        let PolicyTrainer { network, trainer, .. } = self;
        let observations = Observations::Rows(observations, minibatch);
        let batch = Batch { observations, extra_inputs: &[] };
        let step =
            trainer.step(network, parameters, batch, shard_rows, learning_rate, |shard, sum| {
                let rows = &minibatch[shard.rows.clone()];
                differentiate(shard, rows, loss, sum)
            });
        Metrics { gradient_norm: step.gradient_norm, ..step.terms }
    }

    /// Adds the optimizer's state to `tensors`, under this name.
    pub(crate) fn save(&self, name: &str, tensors: &mut Tensors) {
        self.trainer.save(name, tensors);
    }

    /// Restores what [`PolicyTrainer::save`] added.
    pub(crate) fn restore(&mut self, name: &str, tensors: &Tensors) -> Result<(), String> {
        self.trainer.restore(name, tensors)
    }
}

/// Adds the gradient of a loss over the rows of a shard to `sum`; returns the sum of their metrics.
fn differentiate<L: RowLoss>(
    shard: Shard<'_, ActorCritic>,
    rows: &[u32],
    loss: &L,
    sum: &mut [f32],
) -> Metrics {
    let Shard { network, prepared, batch, workspace, .. } = shard;
    let (parameters, values) = if L::OF_VALUES {
        let evaluation = network.forward(prepared, batch, workspace);
        (evaluation.parameters, Some(evaluation.values))
    } else {
        (network.act(prepared, batch, workspace), None)
    };
    let width = parameters.nrows();
    let mut parameter_gradients = DMatrix::zeros(width, rows.len());
    let mut value_gradients = DMatrix::zeros(1, rows.len());
    let mut metrics = Metrics::default();
    let columns = parameters.as_slice().chunks_exact(width);
    let gradients = parameter_gradients.as_mut_slice().chunks_exact_mut(width);
    for (position, ((&row, parameters), gradient)) in
        rows.iter().zip(columns).zip(gradients).enumerate()
    {
        let value = values.map_or(0.0, |values| values[(0, position)]);
        let (own, derivative) =
            loss.of_row(row as usize, RowOutput { parameters, value }, gradient);
        metrics += own;
        value_gradients[(0, position)] = derivative;
    }
    let value_gradients = L::OF_VALUES.then_some(&value_gradients);
    network.backward(prepared, batch, workspace, &parameter_gradients, value_gradients, sum);
    metrics
}
