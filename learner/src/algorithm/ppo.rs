//! Proximal policy optimization with clipped ratios and values (Table 2; Algorithm 1, line 9).
//!
//! A minibatch is cut into shards of a fixed number of rows. Threads take whole shards and their
//! gradients are added in shard order, so the number of threads never changes a bit.

use nalgebra::DMatrix;
use networks::{ActorCritic, Adam, Batch as Rows, Distribution, PolicyWorkspace, PreparedPolicy};
use protocol::config::PpoConfig;
use protocol::seed::{self, Purpose};
use protocol::task::Spec;
use rand::seq::SliceRandom;
use rayon::ThreadPool;
use rayon::prelude::*;

use crate::advantage::{generalized_advantages, normalize};
use crate::algorithm::Figures;
use crate::batch::Batch;

/// Most rows of a shard. Part of what a run means: changing it changes the order of sums.
const SHARD_ROWS: usize = 128;

/// A minibatch is cut into at least so many shards: what two threads can share.
const SHARDS_MIN: usize = 2;

/// The policy learner.
pub struct Ppo {
    spec: Spec,
    config: PpoConfig,
    network: ActorCritic,
    threads: ThreadPool,
    shards: Vec<Shard>,
    prepared: PreparedPolicy,
}

/// Everything a thread needs for one shard; reused from minibatch to minibatch.
struct Shard {
    workspace: PolicyWorkspace,
    observations: Vec<u8>,
    parameter_slopes: DMatrix<f32>,
    value_slopes: DMatrix<f32>,
    gradient: Vec<f32>,
    figures: Figures,
}

/// What the rows of a batch are pulled towards.
struct Targets {
    values: Vec<f32>,
    returns: Vec<f32>,
    advantages: Vec<f32>,
}

/// What changes over a run.
#[derive(Clone, Copy, Debug)]
pub struct Schedule {
    /// Seed of the run.
    pub run_seed: u64,
    /// The iteration, which names the minibatch streams.
    pub iteration: u64,
    /// Adam's learning rate.
    pub learning_rate: f64,
}

impl Ppo {
    /// A learner of this network on these threads.
    pub fn new(spec: Spec, config: PpoConfig, network: ActorCritic, threads: ThreadPool) -> Ppo {
        let prepared = PreparedPolicy::default();
        Ppo { spec, config, network, threads, shards: Vec::new(), prepared }
    }

    /// Improves the parameters with a batch: several epochs of minibatches, none after one that took
    /// the policy farther than `target_kl`.
    pub fn update(
        &mut self,
        parameters: &mut [f32],
        optimizer: &mut Adam,
        batch: &Batch,
        schedule: &Schedule,
    ) -> Figures {
        let targets = self.targets(parameters, batch);
        let size = batch.len() / self.config.minibatches as usize;
        let mut rows: Vec<u32> = (0..batch.len() as u32).collect();
        let mut figures = Figures::default();
        let mut epochs = 0;
        for epoch in 0..self.config.epochs {
            let Schedule { run_seed, iteration, learning_rate } = *schedule;
            let purpose = Purpose::PolicyMinibatches;
            rows.shuffle(&mut seed::stream(run_seed, purpose, iteration, epoch));
            let minibatches = rows.chunks_exact(size);
            let count = minibatches.len() as f64;
            let mut of_epoch = Figures::default();
            for minibatch in minibatches {
                let mut own = self.gradient(parameters, batch, &targets, minibatch);
                let gradient = &mut self.shards[0].gradient;
                let largest = self.config.max_gradient_norm;
                own.gradient_norm = networks::clip_global_norm(gradient, largest);
                optimizer.update(parameters, gradient, learning_rate);
                of_epoch.add(&own);
            }
            let of_epoch = of_epoch.divided_by(count);
            figures.add(&of_epoch);
            epochs += 1;
            let target = self.config.target_kl;
            if target > 0.0 && of_epoch.approximate_kl > target {
                break;
            }
        }
        figures.divided_by(f64::from(epochs))
    }

    /// Values under the current policy, and from them advantages and returns.
    fn targets(&mut self, parameters: &[f32], batch: &Batch) -> Targets {
        self.network.prepare_into(parameters, &mut self.prepared);
        let values = self.values(&batch.observations);
        let bootstrap = self.config.bootstrap_truncated;
        let cut = batch.episodes.iter().filter(|episode| bootstrap && episode.truncated);
        let cut: Vec<&[u8]> = cut.map(|episode| &episode.last_observation[..]).collect();
        let mut last_values = self.values(&cut.concat()).into_iter();
        let (gamma, lambda) = (self.config.gamma as f32, self.config.gae_lambda as f32);
        let (mut advantages, mut returns) = (Vec::new(), Vec::new());
        let mut start = 0;
        for episode in &batch.episodes {
            let last_value = match bootstrap && episode.truncated {
                true => last_values.next().expect("one value per episode that was cut"),
                false => 0.0,
            };
            let rows = start..start + episode.steps;
            let (rewards, values) = (&batch.rewards[rows.clone()], &values[rows]);
            let own = generalized_advantages(rewards, values, last_value, gamma, lambda);
            advantages.extend(own.0);
            returns.extend(own.1);
            start += episode.steps;
        }
        normalize(&mut advantages);
        Targets { values, returns, advantages }
    }

    /// Values of observations under the prepared parameters.
    fn values(&self, observations: &[u8]) -> Vec<f32> {
        let shards = observations.par_chunks(SHARD_ROWS * self.spec.observation.bytes());
        let value = |workspace: &mut PolicyWorkspace, rows: &[u8]| {
            let evaluation = self.network.forward(&self.prepared, Rows::new(rows), workspace);
            evaluation.values.as_slice().to_vec()
        };
        let values = || shards.map_init(PolicyWorkspace::default, value).collect::<Vec<_>>();
        self.threads.install(values).concat()
    }

    fn grow_shards(&mut self, count: usize) {
        let parameters = self.network.parameter_count();
        let shard = || Shard {
            workspace: PolicyWorkspace::default(),
            observations: Vec::new(),
            parameter_slopes: DMatrix::zeros(0, 0),
            value_slopes: DMatrix::zeros(0, 0),
            gradient: vec![0.0; parameters],
            figures: Figures::default(),
        };
        if self.shards.len() < count {
            self.shards.resize_with(count, shard);
        }
    }

    /// The gradient of a minibatch, left in the first shard.
    fn gradient(
        &mut self,
        parameters: &[f32],
        batch: &Batch,
        targets: &Targets,
        minibatch: &[u32],
    ) -> Figures {
        self.network.prepare_into(parameters, &mut self.prepared);
        let shard_rows = SHARD_ROWS.min(minibatch.len().div_ceil(SHARDS_MIN));
        let count = minibatch.len().div_ceil(shard_rows);
        self.grow_shards(count);
        let loss = Loss {
            spec: &self.spec,
            config: &self.config,
            network: &self.network,
            prepared: &self.prepared,
            batch,
            targets,
            weight: 1.0 / minibatch.len() as f32,
        };
        let shards = &mut self.shards[..count];
        self.threads.install(|| {
            let rows = minibatch.par_chunks(shard_rows);
            shards.par_iter_mut().zip(rows).for_each(|(shard, rows)| loss.of_shard(shard, rows));
        });
        let (sum, further) = shards.split_at_mut(1);
        for shard in further {
            networks::add(&mut sum[0].gradient, &shard.gradient);
            sum[0].figures.add(&shard.figures);
        }
        sum[0].figures
    }
}

/// The loss of a minibatch.
struct Loss<'a> {
    spec: &'a Spec,
    config: &'a PpoConfig,
    network: &'a ActorCritic,
    prepared: &'a PreparedPolicy,
    batch: &'a Batch,
    targets: &'a Targets,
    /// One over the rows of the minibatch.
    weight: f32,
}

impl Loss<'_> {
    /// Gradient and figures of a shard.
    fn of_shard(&self, shard: &mut Shard, rows: &[u32]) {
        let bytes = self.spec.observation.bytes();
        shard.observations.clear();
        for &row in rows {
            let start = row as usize * bytes;
            shard.observations.extend(&self.batch.observations[start..start + bytes]);
        }
        let batch = Rows::new(&shard.observations);
        let evaluation = self.network.forward(self.prepared, batch, &mut shard.workspace);
        let width = evaluation.parameters.nrows();
        shard.parameter_slopes.resize_mut(width, rows.len(), 0.0);
        shard.value_slopes.resize_mut(1, rows.len(), 0.0);
        shard.figures = Figures::default();
        for (position, &row) in rows.iter().enumerate() {
            let column = |matrix: &DMatrix<f32>| position * matrix.nrows();
            let parameters = &evaluation.parameters.as_slice()[column(evaluation.parameters)..];
            let start = column(&shard.parameter_slopes);
            let slopes = &mut shard.parameter_slopes.as_mut_slice()[start..start + width];
            let own = self.policy(row as usize, &parameters[..width], slopes);
            shard.figures.add(&own);
            let value = evaluation.values[(0, position)];
            let (loss, slope) = self.value(row as usize, value);
            shard.figures.value_loss += loss;
            shard.value_slopes[(0, position)] = slope;
        }
        shard.gradient.fill(0.0);
        self.network.backward(
            self.prepared,
            batch,
            &mut shard.workspace,
            &shard.parameter_slopes,
            Some(&shard.value_slopes),
            &mut shard.gradient,
        );
    }

    /// Clipped surrogate and entropy bonus of one row, and their slopes.
    fn policy(&self, row: usize, parameters: &[f32], slopes: &mut [f32]) -> Figures {
        let distribution: Distribution = self.network.distribution();
        let bytes = self.spec.action.bytes();
        let action = &self.batch.actions[row * bytes..(row + 1) * bytes];
        let difference =
            distribution.log_probability(parameters, action) - self.batch.log_probs[row];
        let ratio = libm::expf(difference);
        let clip = self.config.clip as f32;
        let advantage = self.targets.advantages[row];
        let clipped = ratio.clamp(1.0 - clip, 1.0 + clip) * advantage;
        let free = ratio * advantage;
        let log_prob_slope = if free <= clipped { -free * self.weight } else { 0.0 };
        let entropy_slope = -(self.config.entropy_coefficient as f32) * self.weight;
        distribution.gradient(parameters, action, log_prob_slope, entropy_slope, slopes);
        let weight = f64::from(self.weight);
        Figures {
            policy_loss: -weight * f64::from(free.min(clipped)),
            entropy: weight * f64::from(distribution.entropy(parameters)),
            approximate_kl: weight * f64::from((ratio - 1.0) - difference),
            clip_fraction: if (ratio - 1.0).abs() > clip { weight } else { 0.0 },
            ..Figures::default()
        }
    }

    /// Clipped value loss of one row, and its slope.
    fn value(&self, row: usize, value: f32) -> (f64, f32) {
        let (old, target) = (self.targets.values[row], self.targets.returns[row]);
        let clip = if self.config.value_clip > 0.0 {
            self.config.value_clip as f32
        } else {
            f32::INFINITY
        };
        let clipped = old + (value - old).clamp(-clip, clip);
        let (free_error, clipped_error) = (value - target, clipped - target);
        let (free, held) = (free_error * free_error, clipped_error * clipped_error);
        let slope = if free >= held { free_error } else { 0.0 };
        let coefficient = self.config.value_coefficient as f32 * self.weight;
        (0.5 * f64::from(self.weight) * f64::from(free.max(held)), coefficient * slope)
    }
}
