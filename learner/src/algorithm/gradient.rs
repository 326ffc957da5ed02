//! The gradient of a loss over some rows of a batch, on several threads.
//!
//! A minibatch is cut into shards of a fixed number of rows. Threads take whole shards and their
//! gradients are added in shard order, so the number of threads never changes a bit.

use std::sync::Arc;

use nalgebra::DMatrix;
use networks::{ActorCritic, Batch as Rows, PolicyWorkspace, PreparedPolicy};
use rayon::ThreadPool;
use rayon::prelude::*;

use crate::algorithm::Metrics;

/// Most rows of a shard. Part of what a run means: changing it changes the order of sums.
const SHARD_ROWS: usize = 128;

/// A minibatch is cut into at least so many shards: what two threads can share.
const SHARDS_MIN: usize = 2;

/// A loss that is a sum over rows.
pub(crate) trait RowLoss: Sync {
    /// Whether it depends on the values as well as on the action parameters.
    const OF_VALUES: bool;

    /// Metrics of one row, of the batch and the parameters the network gave for it; writes the gradients of the parameters
    /// and returns that of the value.
    fn of_row(&self, row: usize, output: RowOutput<'_>, gradients: &mut [f32]) -> (Metrics, f32);
}

/// What a network says about one row.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RowOutput<'a> {
    /// Parameters of the action distribution.
    pub(crate) parameters: &'a [f32],
    /// The value; 0 where none is asked for.
    pub(crate) value: f32,
}

/// A network, and the memory its gradients are computed in.
pub(crate) struct Gradient {
    network: ActorCritic,
    row_bytes: usize,
    threads: Arc<ThreadPool>,
    shards: Vec<Shard>,
    prepared: PreparedPolicy,
}

/// Everything a thread needs for one shard; reused from minibatch to minibatch.
struct Shard {
    workspace: PolicyWorkspace,
    observations: Vec<u8>,
    parameter_gradients: DMatrix<f32>,
    value_gradients: DMatrix<f32>,
    gradient: Vec<f32>,
    metrics: Metrics,
}

impl Gradient {
    /// For a network over rows of so many bytes.
    pub(crate) fn new(network: ActorCritic, row_bytes: usize, threads: Arc<ThreadPool>) -> Self {
        let prepared = PreparedPolicy::default();
        Gradient { network, row_bytes, threads, shards: Vec::new(), prepared }
    }

    /// The network.
    pub(crate) fn network(&self) -> &ActorCritic {
        &self.network
    }

    /// Bytes of a row.
    pub(crate) fn row_bytes(&self) -> usize {
        self.row_bytes
    }

    /// Values of rows of observations, in order.
    pub(crate) fn values(&mut self, parameters: &[f32], observations: &[u8]) -> Vec<f32> {
        self.by_shard(parameters, observations, |network, prepared, rows, workspace| {
            network.forward(prepared, rows, workspace).values.as_slice().to_vec()
        })
    }

    /// What `of_row` makes of the action parameters of rows of observations, in order.
    pub(crate) fn outputs<T: Send + Clone>(
        &mut self,
        parameters: &[f32],
        observations: &[u8],
        of_row: impl Fn(&[f32]) -> T + Sync,
    ) -> Vec<T> {
        self.by_shard(parameters, observations, |network, prepared, rows, workspace| {
            let outputs = network.act(prepared, rows, workspace);
            outputs.as_slice().chunks_exact(outputs.nrows()).map(&of_row).collect()
        })
    }

    fn by_shard<T: Send + Clone>(
        &mut self,
        parameters: &[f32],
        observations: &[u8],
        of_shard: impl Fn(&ActorCritic, &PreparedPolicy, Rows<'_>, &mut PolicyWorkspace) -> Vec<T>
        + Sync,
    ) -> Vec<T> {
        let Gradient { network, prepared, .. } = self;
        network.prepare_into(parameters, prepared);
        let shards = observations.par_chunks(SHARD_ROWS * self.row_bytes);
        let of_shard = |workspace: &mut PolicyWorkspace, rows: &[u8]| {
            of_shard(network, prepared, Rows::new(rows), workspace)
        };
        let rows = || shards.map_init(PolicyWorkspace::default, of_shard).collect::<Vec<_>>();
        self.threads.install(rows).concat()
    }

    /// The gradient of a loss over the rows of a minibatch, and the sum of their metrics.
    pub(crate) fn of(
        &mut self,
        parameters: &[f32],
        observations: &[u8],
        minibatch: &[u32],
        loss: &impl RowLoss,
    ) -> (&mut [f32], Metrics) {
        self.network.prepare_into(parameters, &mut self.prepared);
        let shard_rows = SHARD_ROWS.min(minibatch.len().div_ceil(SHARDS_MIN));
        let count = minibatch.len().div_ceil(shard_rows);
        self.grow(count);
        let Gradient { network, row_bytes, prepared, shards, threads, .. } = self;
        let shards = &mut shards[..count];
        threads.install(|| {
            let rows = minibatch.par_chunks(shard_rows);
            shards.par_iter_mut().zip(rows).for_each(|(shard, rows)| {
                shard.gather(observations, *row_bytes, rows);
                shard.differentiate(network, prepared, rows, loss);
            });
        });
        let (sum, further) = shards.split_at_mut(1);
        for shard in further {
            networks::add(&mut sum[0].gradient, &shard.gradient);
            sum[0].metrics.add(&shard.metrics);
        }
        (&mut sum[0].gradient, sum[0].metrics)
    }

    fn grow(&mut self, count: usize) {
        let parameters = self.network.parameter_count();
        let shard = || Shard {
            workspace: PolicyWorkspace::default(),
            observations: Vec::new(),
            parameter_gradients: DMatrix::zeros(0, 0),
            value_gradients: DMatrix::zeros(0, 0),
            gradient: vec![0.0; parameters],
            metrics: Metrics::default(),
        };
        if self.shards.len() < count {
            self.shards.resize_with(count, shard);
        }
    }
}

impl Shard {
    fn gather(&mut self, observations: &[u8], row_bytes: usize, rows: &[u32]) {
        self.observations.clear();
        for &row in rows {
            let start = row as usize * row_bytes;
            self.observations.extend(&observations[start..start + row_bytes]);
        }
    }

    fn differentiate<L: RowLoss>(
        &mut self,
        network: &ActorCritic,
        prepared: &PreparedPolicy,
        rows: &[u32],
        loss: &L,
    ) {
        let batch = Rows::new(&self.observations);
        let (parameters, values) = if L::OF_VALUES {
            let evaluation = network.forward(prepared, batch, &mut self.workspace);
            (evaluation.parameters, Some(evaluation.values))
        } else {
            (network.act(prepared, batch, &mut self.workspace), None)
        };
        let width = parameters.nrows();
        self.parameter_gradients.resize_mut(width, rows.len(), 0.0);
        self.value_gradients.resize_mut(1, rows.len(), 0.0);
        self.metrics = Metrics::default();
        let columns = parameters.as_slice().chunks_exact(width);
        let gradients = self.parameter_gradients.as_mut_slice().chunks_exact_mut(width);
        for (position, ((&row, parameters), gradients)) in
            rows.iter().zip(columns).zip(gradients).enumerate()
        {
            let value = values.map_or(0.0, |values| values[(0, position)]);
            let (metrics, derivative) =
                loss.of_row(row as usize, RowOutput { parameters, value }, gradients);
            self.metrics.add(&metrics);
            self.value_gradients[(0, position)] = derivative;
        }
        self.gradient.fill(0.0);
        let value_gradients = L::OF_VALUES.then_some(&self.value_gradients);
        let gradients = &self.parameter_gradients;
        network.backward(
            prepared,
            batch,
            &mut self.workspace,
            gradients,
            value_gradients,
            &mut self.gradient,
        );
    }
}
