//! The ensemble of every learned reward model: its training step, its scores, its state.
//!
//! Every member sees the same minibatches; their only difference is where they start. Members are
//! trained, and shards of rows scored, on several threads: each result is computed by one thread in
//! a fixed order, so the number of threads never changes a bit.

use networks::{
    Adam, Ensemble, Network, Prepared, RewardArchitecture, RunningNormalizer, Score as RowScore,
    Workspace,
};
use protocol::seed::{self, Purpose};
use protocol::tensors::Tensors;
use protocol::weights;
use rayon::ThreadPool;
use rayon::prelude::*;
use run::config::RewardConfig;

use super::input::{Input, Rows};
use super::minibatch::{Losses, Minibatch};

/// Adam's epsilon, as in the authors' code.
const ADAM_EPSILON: f64 = 1e-8;

/// Rows scored at a time by one thread.
const SHARD_ROWS: usize = 64;

/// An ensemble with its optimizers.
pub struct TrainedEnsemble {
    input: Input,
    normalizer: RunningNormalizer,
    ensemble: Ensemble,
    trainers: Vec<Trainer>,
    prepared: Vec<Prepared>,
    threads: ThreadPool,
}

/// A member's optimizer, and memory that its training reuses.
#[derive(Clone, Debug)]
struct Trainer {
    optimizer: Adam,
    prepared: Prepared,
    workspace: Workspace,
    gradient: Vec<f32>,
}

impl TrainedEnsemble {
    /// A fresh ensemble over rows of an input. If `squashed`, its members' outputs pass through a
    /// sigmoid before they are averaged.
    pub fn new(
        input: Input,
        config: &RewardConfig,
        run_seed: u64,
        normalizer: RunningNormalizer,
        squashed: bool,
        threads: ThreadPool,
    ) -> Self {
        let RewardConfig { convolution_channels, features, hidden, .. } = config;
        let architecture = RewardArchitecture::new(convolution_channels, *features, hidden);
        let network = Network::new(input.network_shape(&architecture));
        let members = 0..config.ensemble as u64;
        let streams =
            members.map(|member| seed::stream(run_seed, Purpose::RewardWeights, member, 0));
        let ensemble = Ensemble { squashed, ..Ensemble::new(network, streams) };
        let parameters = ensemble.members[0].len();
        let trainer = Trainer {
            optimizer: Adam::new(parameters, ADAM_EPSILON),
            prepared: Prepared::default(),
            workspace: Workspace::default(),
            gradient: vec![0.0; parameters],
        };
        TrainedEnsemble {
            input,
            normalizer,
            trainers: vec![trainer; config.ensemble],
            prepared: ensemble.prepare(),
            ensemble,
            threads,
        }
    }

    /// Rows as the networks see them.
    pub fn normalized(&self, rows: Vec<u8>) -> Rows {
        let mut rows = self.input.split(rows);
        self.normalizer.normalize(&mut rows.observations);
        rows
    }

    /// One optimizer step of every member. The loss takes the outputs of one member and gives their
    /// gradients. [`TrainedEnsemble::prepare`] has to follow before rows are scored.
    ///
    /// # Errors
    /// When a loss or the gradient of a member is no number; which one.
    pub fn train(
        &mut self,
        minibatch: &Minibatch,
        loss: impl Fn(&Minibatch, &[f32], &mut [f32]) -> Losses + Sync,
        learning_rate: f64,
    ) -> Result<Losses, String> {
        let network = &self.ensemble.network;
        let members = self.ensemble.members.par_iter_mut().zip(&mut self.trainers);
        let train = |(member, trainer): (&mut Vec<f32>, &mut Trainer)| {
            let losses = trainer.differentiate(network, member, minibatch, &loss);
            let problem = losses.problem(&trainer.gradient);
            trainer.optimizer.update(member, &trainer.gradient, learning_rate);
            problem.map_or(Ok(losses), Err)
        };
        let trained: Vec<_> = self.threads.install(|| members.map(train).collect());
        let numbered = trained.into_iter().enumerate();
        let losses: Result<Vec<Losses>, String> = numbered
            .map(|(member, losses)| losses.map_err(|problem| format!("member {member}: {problem}")))
            .collect();
        losses.map(|losses| Losses::mean(&losses))
    }

    /// Refuses weights and optimizers that are no numbers any more.
    ///
    /// # Errors
    /// Names the array.
    pub fn expect_finite(&self) -> Result<(), String> {
        let mut tensors = Tensors::default();
        self.save(&mut tensors);
        tensors.expect_finite()
    }

    /// Makes the trained weights those that rows are scored with.
    pub fn prepare(&mut self) {
        self.prepared = self.ensemble.prepare();
    }

    /// Scores of rows, in order.
    pub fn scores(&self, rows: &[u8]) -> Vec<RowScore> {
        let score = |workspace: &mut Workspace, shard: &[u8]| {
            let (mut outputs, mut scores) = (Vec::new(), Vec::new());
            let rows = self.normalized(shard.to_vec());
            self.ensemble.score(&self.prepared, rows.batch(), workspace, &mut outputs, &mut scores);
            scores
        };
        let shards = rows.par_chunks(SHARD_ROWS * self.input.row_bytes());
        let scores = || shards.map_init(Workspace::default, score).collect::<Vec<_>>();
        self.threads.install(scores).concat()
    }

    /// Hash of all weights.
    pub fn sha256(&self) -> String {
        weights::sha256(self.ensemble.members.iter().map(Vec::as_slice))
    }

    /// Adds weights, optimizers and normalization to a checkpoint.
    pub fn save(&self, tensors: &mut Tensors) {
        tensors.put_f64("moments", self.normalizer.to_numbers());
        let members = self.ensemble.members.iter().zip(&self.trainers).enumerate();
        for (number, (member, trainer)) in members {
            tensors.put_f32(&format!("member{number}.parameters"), member.iter().copied());
            trainer.optimizer.save(&format!("member{number}.adam"), tensors);
        }
    }

    /// Takes over what [`TrainedEnsemble::save`] added.
    ///
    /// # Errors
    /// When the arrays are not those of this ensemble.
    pub fn restore(&mut self, tensors: &Tensors) -> Result<(), String> {
        let moments = self.normalizer.to_numbers().len();
        let moments = tensors.exactly("moments", moments, Tensors::f64)?;
        self.normalizer = RunningNormalizer::from_numbers(&moments);
        let members = self.ensemble.members.iter_mut().zip(&mut self.trainers).enumerate();
        for (number, (member, trainer)) in members {
            let name = format!("member{number}.parameters");
            *member = tensors.exactly(&name, member.len(), Tensors::f32)?;
            trainer.optimizer.restore(&format!("member{number}.adam"), tensors)?;
        }
        self.prepare();
        Ok(())
    }
}

impl Trainer {
    /// Losses of one member, and the gradient of their sum and of the penalty.
    fn differentiate(
        &mut self,
        network: &Network,
        member: &[f32],
        minibatch: &Minibatch,
        loss: impl Fn(&Minibatch, &[f32], &mut [f32]) -> Losses,
    ) -> Losses {
        let Trainer { prepared, workspace, gradient, .. } = self;
        network.prepare_into(member, prepared);
        let batch = minibatch.rows.batch();
        let outputs = network.forward(prepared, batch, workspace);
        let mut gradients = outputs.clone();
        let losses = loss(minibatch, outputs.as_slice(), gradients.as_mut_slice());
        gradient.fill(0.0);
        network.backward(prepared, batch, workspace, &gradients, gradient);
        if let Some(penalty) = &minibatch.penalty {
            penalty.differentiate(network, prepared, workspace, gradient);
        }
        losses
    }
}
