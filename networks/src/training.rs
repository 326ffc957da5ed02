//! Evaluation and gradient steps on several threads, for policies, Q-functions and ensembles.
//!
//! A batch is split into shards of a fixed number of rows. The threads of the caller's rayon pool process whole
//! shards, and the results are combined in shard order, so the number of threads never changes a bit.

use std::ops::{AddAssign, Range};

use protocol::tensors::Tensors;
use rayon::prelude::*;

use crate::batch::{Batch, RowSize};
use crate::network::{Network, Prepared, Workspace};
use crate::optimizer::{Adam, add, clip_global_norm};
use crate::policy::{ActorCritic, PolicyWorkspace, PreparedPolicy};

/// A network that can be trained by [`ShardedTrainer`].
pub trait Trainable: Sync {
    /// One version of the network's parameters, packed for evaluation.
    type Prepared: Default + Send + Sync;
    /// Memory of one thread for evaluating the network.
    type Workspace: Default + Send;

    /// Returns the size of a row of the batches that the network is evaluated on.
    fn row_size(&self) -> RowSize;

    /// Packs a version of the parameters into the memory of an earlier one.
    fn prepare_into(&self, parameters: &[f32], prepared: &mut Self::Prepared);
}

impl Trainable for Network {
    type Prepared = Prepared;
    type Workspace = Workspace;

    fn row_size(&self) -> RowSize {
        self.row_size()
    }

    fn prepare_into(&self, parameters: &[f32], prepared: &mut Prepared) {
        self.prepare_into(parameters, prepared);
    }
}

impl Trainable for ActorCritic {
    type Prepared = PreparedPolicy;
    type Workspace = PolicyWorkspace;

    fn row_size(&self) -> RowSize {
        self.row_size()
    }

    fn prepare_into(&self, parameters: &[f32], prepared: &mut PreparedPolicy) {
        self.prepare_into(parameters, prepared);
    }
}

/// A shard of a batch, with what is needed to evaluate it.
pub struct Shard<'a, N: Trainable> {
    /// The network.
    pub network: &'a N,
    /// Version of the network's parameters.
    pub prepared: &'a N::Prepared,
    /// Rows of the shard.
    pub batch: Batch<'a>,
    /// Position of these rows in the whole batch.
    pub rows: Range<usize>,
    /// Memory for evaluating the shard.
    pub workspace: &'a mut N::Workspace,
}

/// Evaluates every row of a batch and returns the results in order; `of_shard` returns those of one shard.
///
/// # Panics
/// If `shard_rows` is zero.
pub fn evaluate<N: Trainable, T: Send>(
    network: &N,
    prepared: &N::Prepared,
    batch: Batch<'_>,
    shard_rows: usize,
    of_shard: impl Fn(Shard<'_, N>) -> Vec<T> + Sync,
) -> Vec<T> {
    let size = network.row_size();
    let of_shard = |workspace: &mut N::Workspace, rows: Range<usize>| {
        let batch = batch.slice(rows.clone(), size);
        of_shard(Shard { network, prepared, batch, rows, workspace })
    };
    let rows = batch.rows(size);
    let shards = shards(rows, shard_rows).map_init(N::Workspace::default, of_shard);
    let mut results = Vec::with_capacity(rows);
    shards.collect::<Vec<_>>().into_iter().for_each(|own| results.extend(own));
    results
}

/// Splits `rows` rows into shards.
fn shards(rows: usize, shard_rows: usize) -> impl IndexedParallelIterator<Item = Range<usize>> {
    let shards = (0..rows.div_ceil(shard_rows)).into_par_iter();
    shards.map(move |index| index * shard_rows..rows.min((index + 1) * shard_rows))
}

/// Trainer of a network's parameters: the optimizer, and memory reused from step to step.
pub struct ShardedTrainer<N: Trainable> {
    optimizer: Adam,
    max_gradient_norm: f64,
    prepared: N::Prepared,
    memory: Vec<ShardMemory<N::Workspace>>,
}

/// Memory of one shard, reused from minibatch to minibatch.
#[derive(Default)]
struct ShardMemory<W> {
    workspace: W,
    gradient: Vec<f32>,
}

/// Result of a gradient step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step<T> {
    /// Sum of the loss terms of all shards.
    pub terms: T,
    /// Norm of the gradient before clipping; finite only if the whole gradient is finite.
    pub gradient_norm: f64,
}

impl<N: Trainable> ShardedTrainer<N> {
    /// Creates a trainer for `parameter_count` parameters, whose gradients are clipped to `max_gradient_norm`. An
    /// infinite norm disables clipping.
    pub fn new(parameter_count: usize, adam_epsilon: f64, max_gradient_norm: f64) -> Self {
        ShardedTrainer {
            optimizer: Adam::new(parameter_count, adam_epsilon),
            max_gradient_norm,
            prepared: N::Prepared::default(),
            memory: Vec::new(),
        }
    }

    /// Sets the weight decay ([`Adam::weight_decay`]).
    #[must_use]
    pub fn with_weight_decay(mut self, weight_decay: f64) -> Self {
        self.optimizer.weight_decay = weight_decay;
        self
    }

    /// Takes one step down the gradient of a loss that is a sum over shards. `of_shard` adds the gradient of one
    /// shard to the slice it is given and returns the shard's loss terms.
    ///
    /// # Panics
    /// If the batch is empty, `shard_rows` is zero, or the number of parameters is not that of the optimizer.
    pub fn step<T: AddAssign + Send>(
        &mut self,
        network: &N,
        parameters: &mut [f32],
        batch: Batch<'_>,
        shard_rows: usize,
        learning_rate: f64,
        of_shard: impl Fn(Shard<'_, N>, &mut [f32]) -> T + Sync,
    ) -> Step<T> {
        network.prepare_into(parameters, &mut self.prepared);
        let size = network.row_size();
        let shards = shards(batch.rows(size), shard_rows);
        let count = shards.len();
        if self.memory.len() < count {
            self.memory.resize_with(count, ShardMemory::default);
        }
        let ShardedTrainer { prepared, memory, optimizer, .. } = self;
        let memory = &mut memory[..count];
        let terms: Vec<T> = shards
            .zip(memory.par_iter_mut())
            .map(|(rows, ShardMemory { workspace, gradient })| {
                gradient.clear();
                gradient.resize(parameters.len(), 0.0);
                let batch = batch.slice(rows.clone(), size);
                of_shard(Shard { network, prepared, batch, rows, workspace }, gradient)
            })
            .collect();
        let (first, further) = memory.split_first_mut().expect("a batch has a row");
        let gradient = &mut first.gradient;
        further.iter().for_each(|shard| add(gradient, &shard.gradient));
        let terms = terms.into_iter().reduce(|mut sum, shard| {
            sum += shard;
            sum
        });
        let gradient_norm = clip_global_norm(gradient, self.max_gradient_norm);
        optimizer.update(parameters, gradient, learning_rate);
        Step { terms: terms.expect("a batch has a row"), gradient_norm }
    }

    /// Adds the optimizer's state to `tensors`, under `name`.
    pub fn save(&self, name: &str, tensors: &mut Tensors) {
        self.optimizer.save(name, tensors);
    }

    /// Restores the state that [`ShardedTrainer::save`] added.
    ///
    /// # Errors
    /// When an array is missing or has another length.
    pub fn restore(&mut self, name: &str, tensors: &Tensors) -> Result<(), String> {
        self.optimizer.restore(name, tensors)
    }
}
