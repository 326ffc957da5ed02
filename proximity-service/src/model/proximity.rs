//! Goal proximity: an ensemble that regresses how close an observation is to the goal (Eqs. 1, 4, 5).
//!
//! Every member sees the same minibatches; their only difference is where they start. Members are
//! trained, and shards of observations scored, on several threads: each result is computed by one
//! thread in a fixed order, so the number of threads never changes a bit.

use std::time::Instant;

use anyhow::Result;
use networks::{
    Adam, Batch as Rows, Ensemble, Network, Prepared, RewardArchitecture, RunningNormalizer,
    Score as RowScore, Workspace, squared_error,
};
use protocol::config::RewardConfig;
use protocol::learning_rate::LearningRate;
use protocol::messages::{Estimates, RewardUpdate, Score};
use protocol::seed::{self, Purpose};
use protocol::task::{ObservationSpec, Spec};
use protocol::tensors::Tensors;
use protocol::trajectory::Encoded;
use protocol::weights;
use rand::seq::SliceRandom;
use rayon::ThreadPool;
use rayon::prelude::*;

use super::RewardModel;
use crate::demonstrations::Demonstrations;
use crate::experience::Experience;
use crate::reward::rewards;
use crate::target::AGENT_TARGET;

/// Adam's epsilon, as in the authors' code.
const ADAM_EPSILON: f64 = 1e-8;

/// Numbers that vary by less in the demonstrations are not normalized; meters, radians, or per second.
const LEAST_DEVIATION: f64 = 0.01;

/// Observations scored at a time by one thread.
const SHARD_ROWS: usize = 64;

/// The goal proximity function, its training and its reward.
pub struct GoalProximity {
    config: RewardConfig,
    learning_rate: LearningRate,
    observation_bytes: usize,
    run_seed: u64,
    demonstrations: Demonstrations,
    experience: Experience,
    normalizer: RunningNormalizer,
    ensemble: Ensemble,
    trainers: Vec<Trainer>,
    prepared: Vec<Prepared>,
    version: u64,
    threads: ThreadPool,
}

/// A minibatch: demonstration observations, then agent observations, and the label of each.
#[derive(Default)]
struct Minibatch {
    observations: Vec<u8>,
    targets: Vec<f32>,
    demonstrations: usize,
}

/// A member's optimizer, and memory that its training reuses.
#[derive(Clone, Debug)]
struct Trainer {
    optimizer: Adam,
    prepared: Prepared,
    workspace: Workspace,
    gradient: Vec<f32>,
}

/// Losses of a minibatch: the two terms of Eq. 4.
#[derive(Clone, Copy, Debug, Default)]
struct Losses {
    demonstrations: f64,
    agent: f64,
}

impl GoalProximity {
    /// A fresh ensemble for a task.
    pub fn new(
        spec: &Spec,
        config: &RewardConfig,
        learning_rate: LearningRate,
        run_seed: u64,
        demonstrations: Demonstrations,
        threads: ThreadPool,
    ) -> Self {
        let architecture = RewardArchitecture::from(config);
        let network = Network::new(architecture.network_shape(spec.observation, 1, 0));
        let members = 0..config.ensemble as u64;
        let streams =
            members.map(|member| seed::stream(run_seed, Purpose::RewardWeights, member, 0));
        let ensemble = Ensemble::new(network, streams);
        let parameters = ensemble.members[0].len();
        let trainer = Trainer {
            optimizer: Adam::new(parameters, ADAM_EPSILON),
            prepared: Prepared::default(),
            workspace: Workspace::default(),
            gradient: vec![0.0; parameters],
        };
        GoalProximity {
            learning_rate,
            observation_bytes: spec.observation.bytes(),
            run_seed,
            normalizer: normalizer(spec, config, &demonstrations),
            demonstrations,
            experience: Experience::new(config.experience, spec.observation.bytes()),
            trainers: vec![trainer; config.ensemble],
            prepared: ensemble.prepare(),
            ensemble,
            version: 0,
            threads,
            config: config.clone(),
        }
    }

    fn demonstration(&self, position: usize) -> &[u8] {
        let start = position * self.observation_bytes;
        &self.demonstrations.observations[start..start + self.observation_bytes]
    }

    fn minibatch(&self, demonstrations: &[usize], agent: &[usize]) -> Minibatch {
        let mut minibatch =
            Minibatch { demonstrations: demonstrations.len(), ..Minibatch::default() };
        for &position in demonstrations {
            minibatch.observations.extend(self.demonstration(position));
            minibatch.targets.push(self.demonstrations.targets[position]);
        }
        for &position in agent {
            self.experience.append_to(position, &mut minibatch.observations);
            minibatch.targets.push(AGENT_TARGET);
        }
        self.normalizer.normalize(&mut minibatch.observations);
        minibatch
    }

    /// One optimizer step of every member.
    fn train(&mut self, minibatch: &Minibatch, learning_rate: f64) -> Losses {
        let network = &self.ensemble.network;
        let members = self.ensemble.members.par_iter_mut().zip(&mut self.trainers);
        let train = |(member, trainer): (&mut Vec<f32>, &mut Trainer)| {
            let losses = trainer.differentiate(network, member, minibatch);
            trainer.optimizer.update(member, &trainer.gradient, learning_rate);
            losses
        };
        let losses: Vec<Losses> = self.threads.install(|| members.map(train).collect());
        let count = losses.len() as f64;
        Losses {
            demonstrations: losses.iter().map(|loss| loss.demonstrations).sum::<f64>() / count,
            agent: losses.iter().map(|loss| loss.agent).sum::<f64>() / count,
        }
    }

    fn updated(&mut self, iteration: u64, losses: &[Losses], begun: Instant) -> RewardUpdate {
        self.version += 1;
        self.prepared = self.ensemble.prepare();
        let count = losses.len().max(1) as f64;
        RewardUpdate {
            iteration,
            model_version: self.version,
            gradient_steps: losses.len() as u64,
            demonstration_loss: losses.iter().map(|loss| loss.demonstrations).sum::<f64>() / count,
            agent_loss: losses.iter().map(|loss| loss.agent).sum::<f64>() / count,
            weights_sha256: self.sha256(),
            experience: self.experience.len() as u64,
            seconds: begun.elapsed().as_secs_f64(),
        }
    }

    /// Scores of observations, in order.
    fn row_scores(&self, observations: &[u8]) -> Vec<RowScore> {
        let score = |workspace: &mut Workspace, shard: &[u8]| {
            let (mut outputs, mut scores) = (Vec::new(), Vec::new());
            let mut shard = shard.to_vec();
            self.normalizer.normalize(&mut shard);
            let rows = Rows::new(&shard);
            self.ensemble.score(&self.prepared, rows, workspace, &mut outputs, &mut scores);
            scores
        };
        let shards = observations.par_chunks(SHARD_ROWS * self.observation_bytes);
        let scores = || shards.map_init(Workspace::default, score).collect::<Vec<_>>();
        self.threads.install(scores).concat()
    }
}

/// What the ensemble's observations are normalized by.
fn normalizer(
    spec: &Spec,
    config: &RewardConfig,
    demonstrations: &Demonstrations,
) -> RunningNormalizer {
    let ObservationSpec::Vector { len } = spec.observation else {
        return RunningNormalizer::new(0);
    };
    let mut normalizer =
        RunningNormalizer::new(if config.normalize_observations { len } else { 0 });
    normalizer.update(&demonstrations.observations);
    normalizer.leave_constant(LEAST_DEVIATION);
    normalizer
}

impl Trainer {
    /// Losses of one member (Eq. 4; without agent observations Eq. 1), and their gradient. Each term
    /// is a mean over its own observations.
    fn differentiate(
        &mut self,
        network: &Network,
        member: &[f32],
        minibatch: &Minibatch,
    ) -> Losses {
        let Trainer { prepared, workspace, gradient, .. } = self;
        network.prepare_into(member, prepared);
        let rows = Rows::new(&minibatch.observations);
        let outputs = network.forward(prepared, rows, workspace);
        let mut slopes = outputs.clone();
        let count = minibatch.demonstrations;
        let (own, agent) = outputs.as_slice().split_at(count);
        let (own_targets, agent_targets) = minibatch.targets.split_at(count);
        let (own_slopes, agent_slopes) = slopes.as_mut_slice().split_at_mut(count);
        let weight = |rows: usize| 1.0 / rows.max(1) as f32;
        let losses = Losses {
            demonstrations: squared_error(own, own_targets, weight(own.len()), own_slopes),
            agent: squared_error(agent, agent_targets, weight(agent.len()), agent_slopes),
        };
        gradient.fill(0.0);
        network.backward(prepared, rows, workspace, &slopes, gradient);
        losses
    }
}

impl RewardModel for GoalProximity {
    fn pretrain(&mut self) -> RewardUpdate {
        let begun = Instant::now();
        let mut losses = Vec::new();
        let mut order: Vec<usize> = (0..self.demonstrations.len()).collect();
        for epoch in 0..self.config.pretraining_epochs {
            let purpose = Purpose::PretrainingBatches;
            order.shuffle(&mut seed::stream(self.run_seed, purpose, epoch, 0));
            for positions in order.chunks_exact(self.config.batch) {
                let minibatch = self.minibatch(positions, &[]);
                losses.push(self.train(&minibatch, self.learning_rate.first));
            }
        }
        self.updated(0, &losses, begun)
    }

    fn improve(&mut self, iteration: u64, batch: &[Encoded]) -> RewardUpdate {
        let begun = Instant::now();
        for encoded in batch {
            self.experience.push(&encoded.trajectory);
        }
        let samples = self.config.samples.min(self.demonstrations.len());
        let learning_rate = self.learning_rate.at(iteration);
        let mut losses = Vec::new();
        if learning_rate > 0.0 && samples > 0 && self.experience.len() >= samples {
            let purpose = Purpose::ImprovementBatches;
            let mut stream = seed::stream(self.run_seed, purpose, iteration, 0);
            let draw = |count, stream: &mut _| rand::seq::index::sample(stream, count, samples);
            let mut own = draw(self.demonstrations.len(), &mut stream).into_vec();
            let mut agent = draw(self.experience.len(), &mut stream).into_vec();
            own.shuffle(&mut stream);
            agent.shuffle(&mut stream);
            let size = self.config.batch;
            for (own, agent) in own.chunks_exact(size).zip(agent.chunks_exact(size)) {
                let minibatch = self.minibatch(own, agent);
                losses.push(self.train(&minibatch, learning_rate));
            }
        }
        self.updated(iteration, &losses, begun)
    }

    /// Each observation is scored once: the state after one step is the state before the next.
    fn score(&self, iteration: u64, batch: &[Encoded]) -> Vec<Score> {
        let observations: Vec<&[u8]> =
            batch.iter().map(|encoded| encoded.trajectory.observations()).collect();
        let rows = self.row_scores(&observations.concat());
        let mut rest = &rows[..];
        let score = |encoded: &Encoded| {
            let (own, further) = rest.split_at(encoded.trajectory.steps as usize + 1);
            rest = further;
            let proximity: Vec<f32> = own.iter().map(|row| row.proximity).collect();
            let uncertainty: Vec<f32> = own.iter().map(|row| row.uncertainty).collect();
            Score {
                iteration,
                lane: encoded.key.lane,
                episode: encoded.key.episode,
                model_version: self.version,
                rewards: rewards(&proximity, &uncertainty, &self.config),
                proximity,
                uncertainty,
            }
        };
        batch.iter().map(score).collect()
    }

    fn estimate(&self, observations: &[u8]) -> Estimates {
        let rows = self.row_scores(observations);
        Estimates {
            model_version: self.version,
            proximity: rows.iter().map(|row| row.proximity).collect(),
            uncertainty: rows.iter().map(|row| row.uncertainty).collect(),
        }
    }

    fn sha256(&self) -> String {
        weights::sha256(self.ensemble.members.iter().map(Vec::as_slice))
    }

    fn save(&self) -> Tensors {
        let mut tensors = Tensors::default();
        tensors.put_u64("version", [self.version]);
        tensors.put_u8("experience", self.experience.to_bytes());
        tensors.put_f64("moments", self.normalizer.to_numbers());
        let members = self.ensemble.members.iter().zip(&self.trainers).enumerate();
        for (number, (member, trainer)) in members {
            let adam = &trainer.optimizer;
            let name = |part| format!("member{number}.{part}");
            tensors.put_f32(&name("parameters"), member.iter().copied());
            tensors.put_f32(&name("adam.first_moment"), adam.first_moment.iter().copied());
            tensors.put_f32(&name("adam.second_moment"), adam.second_moment.iter().copied());
            tensors.put_u64(&name("adam.step"), [adam.step]);
        }
        tensors
    }

    fn restore(&mut self, tensors: &Tensors) -> Result<(), String> {
        let single = |name: &str| match tensors.u64(name)?[..] {
            [number] => Ok(number),
            ref other => Err(format!("array `{name}`: expected 1 number, found {}", other.len())),
        };
        self.version = single("version")?;
        self.normalizer = RunningNormalizer::from_numbers(&tensors.f64("moments")?);
        let bytes = tensors.u8("experience")?;
        if bytes.len() % self.observation_bytes != 0 {
            return Err(format!("array `experience`: found {} bytes", bytes.len()));
        }
        self.experience = Experience::new(self.config.experience, self.observation_bytes);
        self.experience.push_bytes(&bytes);
        let members = self.ensemble.members.iter_mut().zip(&mut self.trainers).enumerate();
        for (number, (member, trainer)) in members {
            let adam = &mut trainer.optimizer;
            let name = |part| format!("member{number}.{part}");
            let read = |part| {
                let numbers = tensors.f32(&name(part))?;
                let (expected, found) = (member.len(), numbers.len());
                let message =
                    || format!("array `{}`: expected {expected}, found {found}", name(part));
                if found == expected { Ok(numbers) } else { Err(message()) }
            };
            let parts = (read("parameters")?, read("adam.first_moment")?);
            adam.second_moment = read("adam.second_moment")?;
            (*member, adam.first_moment) = parts;
            adam.step = single(&name("adam.step"))?;
        }
        self.prepared = self.ensemble.prepare();
        Ok(())
    }
}
