//! Evaluation and gradient steps on several threads, for policies, Q-functions and ensembles alike.
//!
//! A batch is cut into shards of a fixed number of rows. The threads of the rayon pool that the caller
//! is in take whole shards, and what the shards give is joined in shard order, so the number of threads
//! never changes a bit.

use std::ops::{AddAssign, Range};

use protocol::tensors::Tensors;
use rayon::prelude::*;

use crate::batch::{Batch, RowSize};
use crate::network::{Network, Prepared, Workspace};
use crate::optimizer::{Adam, add, clip_global_norm};
use crate::policy::{ActorCritic, PolicyWorkspace, PreparedPolicy};

/// A network that can be trained by [`ShardedTrainer`].
pub trait Trainable: Sync {
    /// One version of its parameters, packed for evaluation.
    type Prepared: Default + Send + Sync;
    /// What a thread needs to evaluate it.
    type Workspace: Default + Send;

    /// Size of a row of the batches it is evaluated on.
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

/// A shard of a batch, and what it is evaluated with.
pub struct Shard<'a, N: Trainable> {
    /// The network.
    pub network: &'a N,
    /// The version of its parameters.
    pub prepared: &'a N::Prepared,
    /// The rows of the shard.
    pub batch: Batch<'a>,
    /// Where they lie in the whole batch.
    pub rows: Range<usize>,
    /// Memory of the thread that evaluates them.
    pub workspace: &'a mut N::Workspace,
}

/// Results of a network for every row of a batch, in order; `of_shard` gives those of one shard.
///
/// # Panics
/// If `shard_rows` is zero.
pub fn evaluate<N: Trainable, T: Clone + Send>(
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
    let shards = shards(batch.rows(size), shard_rows);
    shards.map_init(N::Workspace::default, of_shard).collect::<Vec<_>>().concat()
}

/// Cuts so many rows into shards.
fn shards(rows: usize, shard_rows: usize) -> impl IndexedParallelIterator<Item = Range<usize>> {
    let shards = (0..rows.div_ceil(shard_rows)).into_par_iter();
    shards.map(move |index| index * shard_rows..rows.min((index + 1) * shard_rows))
}

/// What trains the parameters of a network: the optimizer, and memory reused from step to step.
pub struct ShardedTrainer<N: Trainable> {
    optimizer: Adam,
    max_gradient_norm: f64,
    prepared: N::Prepared,
    memory: Vec<ShardMemory<N::Workspace>>,
}

/// What the shards with the same number need, minibatch after minibatch.
#[derive(Default)]
struct ShardMemory<W> {
    workspace: W,
    gradient: Vec<f32>,
}

/// A gradient step that was taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step<T> {
    /// Sum of the loss terms of all shards.
    pub terms: T,
    /// Norm of the gradient before it was clipped; finite only if the whole gradient was.
    pub gradient_norm: f64,
}

impl<N: Trainable> ShardedTrainer<N> {
    /// A trainer of so many parameters, whose gradients are clipped to a norm. An infinite one clips
    /// none.
    pub fn new(parameter_count: usize, adam_epsilon: f64, max_gradient_norm: f64) -> Self {
        ShardedTrainer {
            optimizer: Adam::new(parameter_count, adam_epsilon),
            max_gradient_norm,
            prepared: N::Prepared::default(),
            memory: Vec::new(),
        }
    }

    /// The same, whose steps shorten the parameters by so much of the learning rate.
    #[must_use]
    pub fn with_weight_decay(mut self, weight_decay: f64) -> Self {
        self.optimizer.weight_decay = weight_decay;
        self
    }

    /// The optimizer.
    pub fn optimizer(&self) -> &Adam {
        &self.optimizer
    }

    /// Takes one step down the gradient of a loss that is a sum over shards. `of_shard` adds the
    /// gradient of one shard to the slice it gets and returns the shard's loss terms.
    ///
    /// # Panics
    /// If the batch or `shard_rows` is empty, or there are not as many parameters as announced.
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

    /// Adds the optimizer's state to arrays, under its name.
    pub fn save(&self, name: &str, tensors: &mut Tensors) {
        self.optimizer.save(name, tensors);
    }

    /// Takes over what [`ShardedTrainer::save`] added.
    ///
    /// # Errors
    /// When an array is missing or of another length.
    pub fn restore(&mut self, name: &str, tensors: &Tensors) -> Result<(), String> {
        self.optimizer.restore(name, tensors)
    }
}
