//! The loop of Algorithm 1, lines 6 to 11.

use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use bus::{Bus, BusAddress};
use mcap_log::{LogOptions, LogWriter};
use prost::Message;
use protocol::messages::{Phase, PolicyUpdate, Progress, RewardUpdate, Score};
use protocol::trajectory::{Encoded, Source};
use run::config::{RunConfig, UpdateOrder};
use run::demonstrations::DEMONSTRATIONS_SHA256;
use run::folder::{PROXIMITY_FILE, Place, RunFolder};
use run::metadata;
use run::origin;
use run::process::{Final, Stop};
use run::process_stat::ProcessorClock;
use run::summary::Seconds;

use crate::algorithm::{Metrics, PolicyLearner, Schedule};
use crate::beginning::Beginning;
use crate::desk::{DeskHandle, Entry, Order, RolledOut, Setup};
use crate::ledger::LeaseLedger;
use crate::service_client::{Begun, Improvement, ServiceClient};
use crate::state::State;

/// How often a waiting trainer checks whether it has to stop.
const LOOK_FOR_STOP: Duration = Duration::from_millis(100);

/// A training run in progress.
pub(crate) struct Trainer {
    pub(crate) folder: RunFolder,
    pub(crate) place: Place,
    pub(crate) config: RunConfig,
    pub(crate) state: State,
    pub(crate) service: ServiceClient,
    pub(crate) desk: DeskHandle,
    pub(crate) progress: Progress,
    pub(crate) learner: Box<dyn PolicyLearner>,
    threads: rayon::ThreadPool,
    pub(crate) stop: Stop,
    pub(crate) seconds: Seconds,
    started: Instant,
    earlier_s: f64,
    clock: ProcessorClock,
}

impl Trainer {
    /// Opens everything: the newest checkpoint or a fresh state, the log, the ports and the connection to the service.
    ///
    /// # Errors
    /// When the folder holds no run, its checkpoint does not fit, or the log or the bus cannot be opened.
    pub(crate) fn start(folder: &RunFolder, stop: &Stop) -> Result<Trainer> {
        let place = folder.place()?;
        let config = folder.config()?;
        let Beginning { learner, state } = Beginning::of_run(folder, &config)?;
        let address = BusAddress::of_run(folder.path())?;
        let bus = Bus::open(&address, "learner-trainer")?;
        let setup = Setup {
            address,
            spec: config.task.spec(),
            run_seed: config.seed,
            weights_bytes: state.policy.weights(u64::MAX).encoded_len(),
            lease_timeout: Duration::from_millis(config.resources.lease_timeout_ms),
            log: open_log(folder, &config)?,
            place: place.clone(),
            stop: stop.clone(),
        };
        let mut desk = DeskHandle::start(setup, &bus)?;
        // A resumed run has completed its first phase, offline training.
        let phase = if state.iteration > 0 { Phase::Training } else { Phase::Pretraining };
        let progress = Progress {
            phase: phase as i32,
            steps_wanted: config.steps_wanted(),
            steps_received: state.environment_steps,
            ..Progress::default()
        };
        desk.order(Order::Tell(progress.clone()))?;
        Ok(Trainer {
            folder: folder.clone(),
            place,
            service: ServiceClient::open(bus, stop)?,
            desk,
            progress,
            learner,
            threads: update_threads(&config)?,
            stop: stop.clone(),
            seconds: Seconds::default(),
            started: Instant::now(),
            earlier_s: state.wall_s,
            clock: ProcessorClock::default(),
            state,
            config,
        })
    }

    /// Trains to the end; returns false if a stop is requested first.
    ///
    /// # Errors
    /// When the bus, the disk or the service fails, or learning diverges.
    pub(crate) fn train(&mut self) -> Result<bool> {
        if !self.pretrain()? {
            return Ok(false);
        }
        self.publish_weights()?;
        if !self.is_over(self.state.iteration) {
            self.open_rollout(self.state.iteration)?;
        }
        while !self.is_over(self.state.iteration) {
            let before = self.seconds;
            let Some(trajectories) = self.collect()? else { return Ok(false) };
            self.state.count(&trajectories);
            self.tell(Phase::Training, None, None)?;
            let next = self.state.iteration + 1;
            if self.config.rollout.lag == 1 && !self.is_over(next) {
                self.open_rollout(next)?;
            }
            self.learn(&trajectories, before)?;
            self.publish_weights()?;
            if self.config.rollout.lag == 0 && !self.is_over(next) {
                self.open_rollout(next)?;
            }
            // The last checkpoint is saved when the run is concluded.
            if !self.is_over(next) && next.is_multiple_of(self.config.checkpoint.iterations) {
                self.save()?;
            }
        }
        Ok(true)
    }

    /// Returns whether training is over after `iteration` iterations.
    fn is_over(&self, iteration: u64) -> bool {
        iteration >= self.config.iterations() || self.learner.is_finished()
    }

    /// Runs lines 2 to 5, unless there is a checkpoint: waits while the service trains offline. Returns false
    /// if a stop is requested first.
    fn pretrain(&mut self) -> Result<bool> {
        let iteration = self.state.iteration;
        let file = match iteration {
            0 => String::new(),
            _ => {
                self.folder.checkpoint_folder(iteration).join(PROXIMITY_FILE).display().to_string()
            }
        };
        while !self.stop.is_requested() {
            match self.service.begin(iteration, &file).context("start of the service")? {
                Begun::Pretraining(pretraining) => {
                    self.progress.pretraining = Some(pretraining);
                    self.tell(Phase::Pretraining, None, None)?;
                    std::thread::sleep(LOOK_FOR_STOP);
                }
                Begun::Ready(update) => {
                    self.progress.pretraining = None;
                    self.state.processor_s += update.processor_s;
                    if iteration == 0 {
                        let taken_s = self.started.elapsed().as_secs_f64();
                        self.earlier_s = (update.seconds - taken_s).max(0.0);
                        self.desk.order(Order::Record(Entry::RewardUpdate(update.clone())))?;
                    }
                    self.tell(Phase::Training, None, Some(update))?;
                    return Ok(true);
                }
            }
        }
        Ok(false)
    }

    /// Opens the rollout of an iteration (line 7), with the policy version that the lag prescribes.
    fn open_rollout(&mut self, iteration: u64) -> Result<()> {
        if !self.config.learner.acts() {
            return Ok(());
        }
        let version = iteration.saturating_sub(self.config.rollout.lag);
        let plans = self.state.plans(iteration, self.config.rollout.lane_steps);
        self.desk.order(Order::Open(LeaseLedger::open(Source::Training, iteration, version, plans)))
    }

    /// Returns the batch of an iteration, which is empty for a learner that needs none; `None` if a stop is
    /// requested first.
    fn collect(&mut self) -> Result<Option<Vec<Encoded>>> {
        if !self.config.learner.acts() {
            return Ok((!self.stop.is_requested()).then(Vec::new));
        }
        let begun = Instant::now();
        let Some(RolledOut { trajectories, actors }) = self.rolled_out()? else { return Ok(None) };
        self.seconds.rollout += begun.elapsed().as_secs_f64();
        self.seconds.environment += actors.environment;
        self.seconds.inference += actors.inference;
        self.seconds.transport += actors.transport;
        self.state.processor_s += actors.processor;
        Ok(Some(trajectories))
    }

    /// Waits for the result of the open rollout; returns `None` if a stop is requested first.
    pub(crate) fn rolled_out(&mut self) -> Result<Option<RolledOut>> {
        while !self.stop.is_requested() {
            if let Some(rolled_out) = self.desk.rolled_out(LOOK_FOR_STOP)? {
                return Ok(Some(rolled_out));
            }
        }
        Ok(None)
    }

    /// Runs lines 8 to 10: scores the batch, updates the policy, improves the proximity function. With
    /// [`UpdateOrder::ScoreFirst`] the last two run at the same time, because they depend only on the batch;
    /// with [`UpdateOrder::ImproveFirst`] the improvement comes before the scores. `before` is the time spent before
    /// the iteration.
    fn learn(&mut self, trajectories: &[Encoded], before: Seconds) -> Result<()> {
        let iteration = self.state.iteration;
        let announced = || self.service.announce(iteration, trajectories);
        timed(&mut self.seconds.scoring, announced)?;
        let (scores, metrics, reward_update);
        match self.config.reward.order {
            UpdateOrder::ImproveFirst => {
                let improvement = self.service.start_improving(iteration)?;
                reward_update = self.improved(improvement)?;
                scores = self.scores(trajectories)?;
                metrics = self.improve_policy(trajectories, &scores)?;
            }
            UpdateOrder::ScoreFirst => {
                scores = self.scores(trajectories)?;
                let improvement = self.service.start_improving(iteration)?;
                metrics = self.improve_policy(trajectories, &scores)?;
                reward_update = self.improved(improvement)?;
            }
        }
        self.state.iteration += 1;
        self.state.wall_s = self.earlier_s + self.started.elapsed().as_secs_f64();
        self.state.processor_s += self.clock.lap() + reward_update.processor_s;
        let update = self.policy_update(trajectories, &scores, &metrics, before);
        self.record(scores, update, reward_update)
    }

    /// Returns the scores of the batch (line 8).
    fn scores(&mut self, trajectories: &[Encoded]) -> Result<Vec<Score>> {
        let scores = || self.service.scores(self.state.iteration, trajectories);
        timed(&mut self.seconds.scoring, scores)
    }

    /// Waits until the proximity function is improved (line 10).
    fn improved(&mut self, improvement: Improvement) -> Result<RewardUpdate> {
        timed(&mut self.seconds.reward_update, || self.service.improved(improvement))
    }

    /// Updates the policy (line 9).
    fn improve_policy(&mut self, trajectories: &[Encoded], scores: &[Score]) -> Result<Metrics> {
        let (run_seed, iteration) = (self.config.seed, self.state.iteration);
        let learning_rate = self.config.policy_learning_rate().at(iteration);
        let schedule = Schedule { run_seed, iteration, learning_rate };
        let State { policy, previous_policy, .. } = &mut self.state;
        if let Some(previous) = previous_policy {
            previous.clone_from(policy);
        }
        let update = || self.learner.update(policy, trajectories, scores, &schedule);
        let updated = timed(&mut self.seconds.policy_update, || self.threads.install(update));
        let metrics = updated.with_context(|| format!("iteration {iteration}"))?;
        if !policy.is_finite() {
            let message = "the learner diverged: expected finite parameters after the update";
            return Err(Final(format!("iteration {iteration}: {message}")).into());
        }
        Ok(metrics)
    }

    /// Returns the success rate of the last 100 training episodes; `None` before the first, or if the task does
    /// not tell success.
    pub(crate) fn success_rate(&self) -> Option<f64> {
        let tells = self.config.task.tells_success && self.state.episodes > 0;
        tells.then(|| self.state.success_rate())
    }

    fn policy_update(
        &self,
        trajectories: &[Encoded],
        scores: &[Score],
        metrics: &Metrics,
        before: Seconds,
    ) -> PolicyUpdate {
        let iteration = self.state.iteration - 1;
        let steps: u64 = trajectories.iter().map(|one| u64::from(one.trajectory.steps)).sum();
        PolicyUpdate {
            iteration,
            policy_version: self.state.iteration,
            environment_steps: self.state.environment_steps,
            episodes: self.state.episodes,
            consumed: trajectories.iter().map(|encoded| encoded.key).collect(),
            minibatch_seed: iteration,
            learning_rate: self.config.policy_learning_rate().at(iteration),
            policy_loss: metrics.policy_loss,
            value_loss: metrics.value_loss,
            entropy: metrics.entropy,
            approximate_kl: metrics.approximate_kl,
            clip_fraction: metrics.clip_fraction,
            gradient_norm: metrics.gradient_norm,
            success_rate: self.success_rate().unwrap_or(f64::NAN),
            mean_reward: mean(scores, |score| &score.rewards),
            mean_proximity: mean(scores, |score| &score.proximity),
            mean_uncertainty: mean(scores, |score| &score.uncertainty),
            mean_episode_steps: steps as f64 / trajectories.len().max(1) as f64,
            weights_sha256: self.state.policy.weights(self.state.iteration).sha256(),
            rollout_s: self.seconds.rollout - before.rollout,
            scoring_s: self.seconds.scoring - before.scoring,
            update_s: self.seconds.policy_update - before.policy_update,
            held_out_loss: metrics.held_out_loss,
            wall_s: self.state.wall_s,
            processor_s: self.state.processor_s,
        }
    }

    fn record(
        &mut self,
        scores: Vec<Score>,
        update: PolicyUpdate,
        reward_update: RewardUpdate,
    ) -> Result<()> {
        self.desk.order(Order::Record(Entry::Scores(scores)))?;
        self.desk.order(Order::Record(Entry::PolicyUpdate(update.clone())))?;
        self.desk.order(Order::Record(Entry::RewardUpdate(reward_update.clone())))?;
        let shown = PolicyUpdate { consumed: Vec::new(), ..update };
        self.tell(Phase::Training, Some(shown), Some(reward_update))
    }

    /// Publishes the run's progress.
    pub(crate) fn tell(
        &mut self,
        phase: Phase,
        update: Option<PolicyUpdate>,
        reward_update: Option<RewardUpdate>,
    ) -> Result<()> {
        let progress = &mut self.progress;
        progress.phase = phase as i32;
        progress.update = update.or(progress.update.take());
        progress.reward_update = reward_update.or(progress.reward_update.take());
        progress.steps_received = self.state.environment_steps;
        progress.lag = self.config.rollout.lag as u32;
        progress.wall_s = self.earlier_s + self.started.elapsed().as_secs_f64();
        let order = Order::Tell(progress.clone());
        self.desk.order(order)
    }

    /// Publishes the policies that may act and have not been published: the newest and, when a run with lag 1 is
    /// resumed, the previous one.
    fn publish_weights(&mut self) -> Result<()> {
        let mut unpublished = self.state.unpublished().into_iter();
        unpublished.try_for_each(|weights| self.desk.order(Order::Publish(weights)))
    }
}

/// Creates the threads that policy updates run on.
fn update_threads(config: &RunConfig) -> Result<rayon::ThreadPool> {
    Ok(rayon::ThreadPoolBuilder::new()
        .num_threads(config.resources.learner_threads)
        .thread_name(|number| format!("update-{number}"))
        .build()?)
}

/// Returns what `work` returns, and adds its wall time to `seconds`.
fn timed<T>(seconds: &mut f64, work: impl FnOnce() -> T) -> T {
    let begun = Instant::now();
    let result = work();
    *seconds += begun.elapsed().as_secs_f64();
    result
}

fn open_log(folder: &RunFolder, config: &RunConfig) -> Result<LogWriter> {
    let mut metadata = metadata::of_run(config);
    let demonstrations = origin::demonstrations_sha256(folder, config);
    if let Some(sha256) = demonstrations.map_err(|error| Final(error.to_string()))? {
        metadata = metadata.with(DEMONSTRATIONS_SHA256, sha256);
    }
    let options = LogOptions {
        rotate_bytes: config.log.file_mib << 20,
        observations: config.log.observations,
    };
    Ok(LogWriter::create(&folder.log(), &metadata, options)?)
}

fn mean(scores: &[Score], numbers: impl Fn(&Score) -> &Vec<f32>) -> f64 {
    let numbers = scores.iter().flat_map(numbers);
    let (count, sum) =
        numbers.fold((0_u64, 0.0), |(count, sum), &number| (count + 1, sum + f64::from(number)));
    sum / count.max(1) as f64
}
