//! Learned reward models: an ensemble trained on rows of demonstrations and rows of the agent. The models differ
//! only in their [`Objective`].

use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use networks::RunningNormalizer;
use protocol::messages::{Estimates, RewardUpdate, Score};
use protocol::seed::{self, Purpose, Stream};
use protocol::task::Spec;
use protocol::tensors::Tensors;
use protocol::trajectory::{Encoded, Trajectory};
use rayon::ThreadPool;
use run::config::{RewardConfig, RewardInput, RunConfig};
use run::learning_rate::LearningRate;
use run::process::Final;

use super::RewardModel;
use super::bootstrap::Resamples;
use super::ensemble::TrainableEnsemble;
use super::input::Input;
use super::minibatch::{Losses, Minibatch, Positions};
use super::objective::{EpisodeView, Objective, Sampler};
use super::offline::{Offline, Progress, Slice};
use super::penalty::GradientPenalty;
use super::threads::threads;
use crate::replay_buffer::ReplayBuffer;

/// A learned reward model.
pub struct Learned<O> {
    objective: O,
    config: RewardConfig,
    learning_rate: LearningRate,
    input: Input,
    run_seed: u64,
    /// Rows of the demonstrations.
    demonstrations: Vec<u8>,
    resamples: Resamples,
    replay_buffer: ReplayBuffer,
    ensemble: TrainableEnsemble,
    version: u64,
    /// Offline training that is under way.
    offline: Option<Offline>,
    /// Progress of offline training in the restored checkpoint.
    resumed: Progress,
}

impl<O: Objective> Learned<O> {
    pub(super) fn of_run(config: &RunConfig, demonstrations: &[Trajectory]) -> Result<Self> {
        let (spec, rate) = (config.task.spec(), config.reward_learning_rate());
        let (reward, threads) = (&config.reward, threads(config)?);
        Ok(Learned::new(&spec, reward, rate, config.seed, demonstrations, threads))
    }

    /// Creates an untrained model for a task.
    pub fn new(
        spec: &Spec,
        config: &RewardConfig,
        learning_rate: LearningRate,
        run_seed: u64,
        demonstrations: &[Trajectory],
        threads: ThreadPool,
    ) -> Self {
        let input = Input::new(spec, config.input);
        let objective = O::new(config, &input, demonstrations);
        let (mut rows, mut counts) = (Vec::new(), Vec::new());
        for trajectory in demonstrations {
            let before = rows.len();
            let (observations, actions) = (trajectory.observations(), trajectory.actions());
            objective.append_training_rows(
                &input,
                EpisodeView { observations, actions },
                &mut rows,
            );
            counts.push((rows.len() - before) / O::kept_bytes(&input));
        }
        let normalizer = RunningNormalizer::of_demonstrations(
            spec.observation.normalized(config.normalize_observations),
            demonstrations.iter().map(Trajectory::observations),
        );
        let ensemble =
            TrainableEnsemble::new(input, config, run_seed, normalizer, O::SQUASHING, threads);
        Learned {
            objective,
            config: config.clone(),
            learning_rate,
            input,
            run_seed,
            demonstrations: rows,
            resamples: Resamples::new(config, run_seed, &counts),
            replay_buffer: ReplayBuffer::new(config.experience_kept(), O::kept_bytes(&input)),
            ensemble,
            version: 0,
            offline: None,
            resumed: Progress::default(),
        }
    }

    fn sampler(&self) -> Sampler<'_> {
        Sampler {
            config: &self.config,
            run_seed: self.run_seed,
            demonstrations: self.demonstrations.len() / O::kept_bytes(&self.input),
        }
    }

    /// Builds the minibatch that a member sees for these positions.
    fn minibatch(&self, member: usize, positions: Positions) -> Minibatch {
        let size = O::kept_bytes(&self.input);
        let positions = self.resamples.of_member(member, positions);
        let mut rows = Vec::new();
        for position in &positions.demonstrations {
            rows.extend(&self.demonstrations[position * size..(position + 1) * size]);
        }
        for &position in &positions.agent {
            self.replay_buffer.append_to(position, &mut rows);
        }
        Minibatch { rows: self.ensemble.normalized(rows), positions, penalty: None }
    }

    /// Takes one optimizer step, the `number`-th, of every member, on a shared minibatch or each on its own.
    fn train(
        &mut self,
        minibatches: &[Minibatch],
        number: usize,
        learning_rate: f64,
    ) -> Result<Losses, Final> {
        let objective = &self.objective;
        let losses = |minibatch: &Minibatch, outputs: &[f32], gradients: &mut [f32]| {
            objective.losses(minibatch, outputs, gradients)
        };
        let trained = self.ensemble.train(minibatches, losses, learning_rate);
        trained.map_err(|message| diverged(&format!("minibatch {number}, {message}")))
    }

    /// Adds the agent's rows of a batch to the replay buffer.
    fn remember(&mut self, batch: &[Encoded]) {
        for Encoded { trajectory, .. } in batch {
            let observations = match self.config.experience_after_goal {
                true => trajectory.observations(),
                false => trajectory.observations_to_goal(),
            };
            let observations = self.up_to_arrival(observations);
            let actions = trajectory.actions();
            let mut rows = Vec::new();
            let seen = EpisodeView { observations, actions };
            self.objective.append_training_rows(&self.input, seen, &mut rows);
            self.replay_buffer.push(&rows);
        }
    }

    /// Returns an episode's observations up to and including the one at which the agent arrived, as the ensemble
    /// estimates it: the first whose proximity is at least the configured share of the episode's highest. An agent
    /// that stays at the goal would otherwise fill the experience, whose label is 0, with states at the goal.
    fn up_to_arrival<'a>(&self, observations: &'a [u8]) -> &'a [u8] {
        let share = self.config.arrival as f32;
        if share <= 0.0 {
            return observations;
        }
        let proximity = O::proximity(&self.ensemble.scores(observations));
        let highest = proximity.iter().copied().fold(0.0, f32::max);
        let is_there = |&proximity: &f32| proximity > 0.0 && proximity >= share * highest;
        let arrival = proximity.iter().position(is_there);
        let kept = arrival.map_or(proximity.len(), |at| at + 1);
        &observations[..kept * self.input.row_bytes()]
    }

    /// Trains on the demonstrations and the replay buffer.
    fn train_online(&mut self, iteration: u64) -> Result<Progress, Final> {
        let mut taken = Progress::default();
        let learning_rate = self.learning_rate.at(iteration);
        if learning_rate <= 0.0 {
            return Ok(taken);
        }
        let agent = self.replay_buffer.len();
        let mut draws: Vec<(Stream, Vec<Positions>)> = (0..self.resamples.minibatches() as u64)
            .map(|member| {
                let purpose = Purpose::ImprovementBatches;
                let mut stream = seed::stream(self.run_seed, purpose, iteration, member);
                let drawn = self.objective.online(&self.sampler(), agent, &mut stream);
                (stream, drawn)
            })
            .collect();
        for step in 0..draws[0].1.len() {
            let of_member = |(member, (stream, drawn)): (usize, &mut (Stream, Vec<Positions>))| {
                self.penalized(self.minibatch(member, drawn[step].clone()), stream)
            };
            let minibatches: Vec<_> = draws.iter_mut().enumerate().map(of_member).collect();
            taken.add(self.train(&minibatches, step + 1, learning_rate)?);
        }
        Ok(taken)
    }

    /// Adds the gradient penalty to a minibatch, if the configuration has one.
    fn penalized(&self, mut minibatch: Minibatch, stream: &mut Stream) -> Minibatch {
        if self.config.gradient_penalty > 0.0 {
            let weight = self.config.gradient_penalty as f32;
            let (rows, pairs) = (&minibatch.rows, minibatch.positions.agent.len());
            minibatch.penalty = Some(GradientPenalty::between(rows, pairs, weight, stream));
        }
        minibatch
    }

    fn updated(&mut self, iteration: u64, taken: &Progress) -> Result<RewardUpdate, Final> {
        self.version += 1;
        self.ensemble.expect_finite().map_err(|message| diverged(&message))?;
        self.ensemble.prepare();
        let mean = taken.mean();
        Ok(RewardUpdate {
            iteration,
            model_version: self.version,
            gradient_steps: taken.done as u64,
            demonstration_loss: mean.demonstrations,
            agent_loss: mean.agent,
            weights_sha256: self.sha256(),
            experience: self.replay_buffer.len() as u64,
            seconds: taken.seconds,
            processor_s: 0.0, // the service fills it in
        })
    }
}

fn diverged(message: &str) -> Final {
    Final(format!("the reward model diverged: {message}"))
}

impl<O: Objective> RewardModel for Learned<O> {
    fn pretrain(&mut self, time: Duration) -> Result<Slice, Final> {
        let begun = Instant::now();
        let mut offline = self.offline.take().unwrap_or_else(|| Offline {
            minibatches: self.objective.offline(&self.sampler()),
            progress: self.resumed,
        });
        let before_s = offline.progress.seconds;
        while let Some((number, positions)) = offline.next() {
            let minibatches: Vec<_> = (0..self.resamples.minibatches())
                .map(|member| self.minibatch(member, positions.clone()))
                .collect();
            let losses = self.train(&minibatches, number, self.learning_rate.first)?;
            offline.progress.add(losses);
            offline.progress.seconds = before_s + begun.elapsed().as_secs_f64();
            if begun.elapsed() >= time && offline.next().is_some() {
                let standing = offline.standing();
                self.offline = Some(offline);
                return Ok(Slice::UnderWay(standing));
            }
        }
        Ok(Slice::Done(self.updated(0, &offline.progress)?))
    }

    fn improve(&mut self, iteration: u64, batch: &[Encoded]) -> Result<RewardUpdate, Final> {
        let begun = Instant::now();
        let mut taken = Progress::default();
        if self.config.trains_online() {
            self.remember(batch);
            taken = self.train_online(iteration)?;
        }
        taken.seconds = begun.elapsed().as_secs_f64();
        self.updated(iteration, &taken)
    }

    /// Scores each row once: the state after one step is the state before the next.
    fn score(&self, iteration: u64, batch: &[Encoded]) -> Vec<Score> {
        let (mut rows, mut counts) = (Vec::new(), Vec::new());
        for Encoded { trajectory, .. } in batch {
            let (observations, actions) = (trajectory.observations(), trajectory.actions());
            let before = rows.len();
            let seen = EpisodeView { observations, actions };
            self.objective.append_scored_rows(&self.input, seen, &mut rows);
            counts.push((rows.len() - before) / self.input.row_bytes());
        }
        let rows = self.ensemble.scores(&rows);
        let mut rest = &rows[..];
        let score = |(encoded, count): (&Encoded, usize)| {
            let (own, further) = rest.split_at(count);
            rest = further;
            let steps = encoded.trajectory.steps as usize;
            Score {
                iteration,
                lane: encoded.key.lane,
                episode: encoded.key.episode,
                model_version: self.version,
                rewards: self.objective.rewards(own, steps, &self.config),
                proximity: O::proximity(own),
                uncertainty: own.iter().map(|row| row.standard_deviation).collect(),
            }
        };
        batch.iter().zip(counts).map(score).collect()
    }

    fn estimate(&self, observations: &[u8]) -> Result<Estimates> {
        let found = match self.input.sees() {
            RewardInput::State | RewardInput::NextState => {
                let rows = self.ensemble.scores(observations);
                return Ok(Estimates {
                    model_version: self.version,
                    proximity: O::proximity(&rows),
                    uncertainty: rows.iter().map(|row| row.standard_deviation).collect(),
                });
            }
            RewardInput::Transition => "transitions",
            RewardInput::StateAction => "states and actions",
        };
        bail!("expected a reward model of single states, found one of {found}")
    }

    fn ensemble(&self) -> Option<&TrainableEnsemble> {
        Some(&self.ensemble)
    }

    fn sha256(&self) -> String {
        self.ensemble.sha256()
    }

    fn save(&self) -> Tensors {
        let mut tensors = Tensors::default();
        tensors.put_u64("version", [self.version]);
        tensors.put_u8("experience", self.replay_buffer.to_bytes());
        self.ensemble.save(&mut tensors);
        if let Some(offline) = &self.offline {
            offline.progress.save(&mut tensors);
        }
        tensors
    }

    fn restore(&mut self, tensors: &Tensors) -> Result<(), String> {
        self.version = tensors.exactly("version", 1, Tensors::u64)?[0];
        let bytes = tensors.u8("experience")?;
        let size = O::kept_bytes(&self.input);
        if !bytes.len().is_multiple_of(size) {
            let found = bytes.len();
            let message = format!("expected whole rows of {size} bytes, found {found} bytes");
            return Err(format!("array `experience`: {message}"));
        }
        self.replay_buffer = ReplayBuffer::new(self.config.experience_kept(), size);
        self.replay_buffer.push(&bytes);
        (self.offline, self.resumed) = (None, Progress::restored(tensors)?);
        self.ensemble.restore(tensors)
    }
}
