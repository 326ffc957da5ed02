//! The learner's desk: the thread that owns the learner's ports and its log.
//!
//! It grants leases to actors, receives trajectories, appends them to the log before anything uses them, and
//! publishes weights and progress, all while the trainer computes. Trainer and desk communicate over two
//! bounded channels: orders one way, complete rollouts the other.
//!
//! Nothing that arrives over the bus is trusted: an unusable message is dropped, reported and counted, and the
//! run goes on.

mod handle;
mod heard;

use std::sync::mpsc::{Receiver, SyncSender, TryRecvError};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use bus::{
    Bus, BusAddress, Doorbell, NewestPublisher, Published, Request, Role, Server,
    TrajectorySubscriber,
};
use bytes::Bytes;
use mcap_log::LogWriter;
use prost::Message;
use protocol::Error;
use protocol::dropped::Dropped;
use protocol::messages::{
    ActorSeconds, Checkpoint, Lease, LeaseReply, LeaseRequest, Phase, PolicyUpdate, Progress,
    RewardUpdate, Score,
};
use protocol::task::Spec;
use protocol::trajectory::Encoded;
use protocol::weights::Weights;
use run::folder::Place;
use run::process::{Final, Stop};

use crate::ledger::{LeaseLedger, Unusable};

use heard::Heard;

pub use handle::DeskHandle;

/// Longest sleep, so that weights are refreshed for late actors in time.
const TICK: Duration = Duration::from_millis(20);

/// Maximum number of messages taken from a port before the desk looks at the others.
const TAKEN_AT_ONCE: usize = 1024;

/// How often the desk cleans up after dead actors and reopens their leases.
const LOOK_AFTER_ACTORS: Duration = Duration::from_millis(500);

/// How often open log chunks are closed, so that a crash loses little.
const FLUSH_LOG: Duration = Duration::from_secs(1);

/// How long to wait before a disk that refused is tried again.
pub(crate) const DISK_PATIENCE: Duration = Duration::from_secs(1);

/// Size reserved for a progress message, in bytes.
const PROGRESS_BYTES: usize = 64 << 10;

/// An order from the trainer.
pub enum Order {
    /// Open a rollout; its batch comes back when it is complete.
    Open(LeaseLedger),
    /// Publish a version of the policy.
    Publish(Weights),
    /// Append to the log.
    Record(Entry),
    /// Publish the run's progress; the desk fills in what it knows better.
    Tell(Progress),
    /// Sync everything appended so far to the disk, then answer.
    Sync(SyncSender<()>),
    /// Tell the actors that the run is over, seal the log and end.
    Finish,
    /// Seal the log and end: the run was stopped, and goes on when it is resumed.
    Stop,
    /// Seal the log and end: the trainer has failed.
    Leave,
}

/// What the trainer records in the log.
pub enum Entry {
    /// Scores, in batch order.
    Scores(Vec<Score>),
    /// A policy update.
    PolicyUpdate(PolicyUpdate),
    /// An update of the reward model.
    RewardUpdate(RewardUpdate),
    /// A checkpoint.
    Checkpoint(Checkpoint),
}

/// The result of a rollout.
pub struct RolledOut {
    /// Its trajectories, by lane and episode.
    pub trajectories: Vec<Encoded>,
    /// Where the time of all actors together went, as reported since the previous rollout.
    pub actors: ActorSeconds,
}

/// What the desk needs to open.
pub struct Setup {
    /// The run's bus.
    pub address: BusAddress,
    /// Shapes of the task.
    pub spec: Spec,
    /// Seed of the run, which its trajectories name.
    pub run_seed: u64,
    /// Length of the longest encoded weights, in bytes.
    pub weights_bytes: usize,
    /// A lease held longer than this is granted again, once no other is open.
    pub lease_timeout: Duration,
    /// The run's log, open.
    pub log: LogWriter,
    /// Where the run is: the desk does not wait for a log whose folder is gone.
    pub place: Place,
    /// Whether the run is to stop: then the desk does not wait for a disk that refuses.
    pub stop: Stop,
}

/// Whether the desk has more to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Work {
    GoesOn,
    /// The run is over, and actors are told so.
    IsDone,
    /// The run was stopped.
    IsStopped,
    /// The trainer has failed; the run goes on when the learner is restarted.
    IsLeft,
}

struct Desk {
    spec: Spec,
    run_seed: u64,
    lease_timeout: Duration,
    bus: Bus,
    doorbell: Doorbell,
    trajectories: TrajectorySubscriber,
    leases: Server,
    weights: NewestPublisher,
    progress: NewestPublisher,
    log: LogWriter,
    place: Place,
    stop: Stop,
    orders: Receiver<Order>,
    rollouts: SyncSender<RolledOut>,
    ledger: Option<LeaseLedger>,
    /// Actors waiting for leases; they are answered when there are some.
    waiting: Vec<(LeaseRequest, Request)>,
    dropped_trajectories: Dropped,
    differing_copies: Dropped,
    dropped_questions: Dropped,
    told: Progress,
    alive: Vec<String>,
    heard: Heard,
    looked_after: Instant,
    flushed: Instant,
    work: Work,
    actors: ActorSeconds,
    log_s: f64,
}

impl Desk {
    fn open(
        setup: Setup,
        orders: Receiver<Order>,
        rollouts: SyncSender<RolledOut>,
    ) -> Result<Desk> {
        let bus = Bus::open(&setup.address, "learner")?;
        Ok(Desk {
            spec: setup.spec,
            run_seed: setup.run_seed,
            lease_timeout: setup.lease_timeout,
            doorbell: bus.doorbell(Role::Learner)?,
            trajectories: bus.learning_subscriber()?,
            leases: bus.lease_server()?,
            weights: bus.weights_publisher(setup.weights_bytes)?,
            progress: bus.progress_publisher(PROGRESS_BYTES)?,
            log: setup.log,
            place: setup.place,
            stop: setup.stop,
            orders,
            rollouts,
            ledger: None,
            waiting: Vec::new(),
            dropped_trajectories: Dropped::new("trajectories from the bus"),
            differing_copies: Dropped::new("copies that differ"),
            dropped_questions: Dropped::new("questions for leases"),
            told: Progress::default(),
            alive: bus.alive()?,
            heard: Heard::default(),
            looked_after: Instant::now(),
            flushed: Instant::now(),
            work: Work::GoesOn,
            actors: ActorSeconds::default(),
            log_s: 0.0,
            bus,
        })
    }

    /// Runs until it is told to end or the trainer is gone; returns the seconds spent appending to the log.
    fn run(&mut self) -> Result<f64> {
        while self.work == Work::GoesOn {
            self.doorbell.wait(TICK)?;
            self.take_orders()?;
            self.take_trajectories()?;
            self.answer_actors()?;
            self.hand_over_batch();
            self.weights.refresh()?;
            self.progress.refresh()?;
            self.look_after_actors()?;
            if self.flushed.elapsed() >= FLUSH_LOG {
                self.complete(LogWriter::flush)?;
                self.flushed = Instant::now();
                self.tell()?;
            }
        }
        if self.work == Work::IsDone {
            self.answer_actors()?;
        }
        match self.work {
            // Its failure does not wait for a disk that refuses.
            Work::IsLeft => self.log.finish()?,
            _ => self.complete(LogWriter::finish)?,
        }
        Ok(self.log_s)
    }

    /// Appends to the log and measures the time. While the disk refuses, the message is kept and the run pauses.
    fn append(&mut self, append: impl FnOnce(&mut LogWriter) -> Result<(), Error>) -> Result<()> {
        let begun = Instant::now();
        if let Err(error) = append(&mut self.log) {
            self.wait_for_room(error)?;
            self.complete(LogWriter::flush)?;
        }
        self.log_s += begun.elapsed().as_secs_f64();
        Ok(())
    }

    /// Flushes, syncs or seals the log; repeats it for as long as the disk refuses, unless the run is to stop.
    fn complete(&mut self, write: impl Fn(&mut LogWriter) -> Result<(), Error>) -> Result<()> {
        while let Err(error) = write(&mut self.log) {
            self.wait_for_room(error)?;
        }
        Ok(())
    }

    /// Pauses before the next attempt to write, unless the run is to stop; what is not on the disk by then is
    /// done again on resuming. After a failed sync waiting does not help: the learner ends, and once restarted
    /// it repairs the log and continues from the last checkpoint.
    fn wait_for_room(&mut self, error: Error) -> Result<()> {
        match error {
            Error::LogWrite { .. } => {}
            // A restarted learner would come to the same message.
            Error::LogRefused { .. } => return Err(Final(error.to_string()).into()),
            _ => return Err(error.into()),
        }
        self.place.check()?;
        if self.stop.is_requested() {
            bail!("stopped while the log could not be written: {error}");
        }
        tracing::error!("paused until the log can be written: {error}");
        let phase = std::mem::replace(&mut self.told.phase, Phase::DiskFull as i32);
        self.tell()?;
        self.told.phase = phase;
        self.stop.sleep(DISK_PATIENCE);
        Ok(())
    }

    fn take_orders(&mut self) -> Result<()> {
        loop {
            match self.orders.try_recv() {
                Ok(order) => self.follow(order)?,
                Err(TryRecvError::Empty) => return Ok(()),
                Err(TryRecvError::Disconnected) => {
                    if self.work == Work::GoesOn {
                        self.work = Work::IsLeft;
                    }
                    return Ok(());
                }
            }
        }
    }

    fn follow(&mut self, order: Order) -> Result<()> {
        match order {
            Order::Open(ledger) => self.ledger = Some(ledger),
            Order::Publish(weights) => self.weights.publish(&weights.encode_to_vec())?,
            Order::Record(entry) => self.record(&entry)?,
            Order::Tell(progress) => {
                self.told = progress;
                self.tell()?;
            }
            Order::Sync(done) => {
                self.complete(LogWriter::sync)?;
                // A trainer that is not waiting any more has failed and reports that itself.
                done.send(()).ok();
            }
            Order::Finish => self.work = Work::IsDone,
            Order::Stop => self.work = Work::IsStopped,
            Order::Leave => self.work = Work::IsLeft,
        }
        Ok(())
    }

    fn record(&mut self, entry: &Entry) -> Result<()> {
        match entry {
            Entry::Scores(scores) => {
                scores.iter().try_for_each(|score| self.append(|log| log.score(score)))
            }
            Entry::PolicyUpdate(update) => self.append(|log| log.policy_update(update)),
            Entry::RewardUpdate(update) => self.append(|log| log.reward_update(update)),
            Entry::Checkpoint(checkpoint) => self.append(|log| log.checkpoint(checkpoint)),
        }
    }

    /// Takes what actors published into the rollout, then appends it to the log. The batch is handed over only
    /// after that, so nothing is learned from that is not in the log.
    fn take_trajectories(&mut self) -> Result<()> {
        for _ in 0..TAKEN_AT_ONCE {
            let Some(published) = self.trajectories.receive()? else { break };
            let Published { header, bytes, process } = published;
            match self.admit(bytes, header.hash) {
                Ok(None) => {}
                Ok(Some(encoded)) => self.append(|log| log.trajectory(&encoded))?,
                Err(why) => {
                    let said = format!("process {process}: {why:#}");
                    match why.downcast_ref() {
                        Some(Unusable::Differs { .. }) => self.differing_copies.note_loudly(said),
                        _ => self.dropped_trajectories.note(said),
                    }
                }
            }
        }
        Ok(())
    }

    /// Takes a trajectory into the rollout; returns it if it is new there.
    fn admit(&mut self, bytes: Bytes, announced: u64) -> Result<Option<Encoded>> {
        let Some(ledger) = &mut self.ledger else { return Ok(None) };
        let encoded = Encoded::decode(bytes, &self.spec)?;
        let hash = encoded.key.hash;
        ensure!(announced == hash, "trajectory: expected hash {announced:016x}, found {hash:016x}");
        let (expected, found) = (self.run_seed, encoded.trajectory.run_seed);
        ensure!(expected == found, "trajectory: expected run seed {expected}, found {found}");
        let holder = ledger.holder(encoded.key.lane).map(str::to_owned);
        let is_new = ledger.receive(encoded.clone())?;
        if let Some(actor) = holder {
            self.heard.note(&actor, if is_new { u64::from(encoded.trajectory.steps) } else { 0 });
        }
        Ok(is_new.then_some(encoded))
    }

    fn answer_actors(&mut self) -> Result<()> {
        for _ in 0..TAKEN_AT_ONCE {
            // Drops abandoned requests first: of a client with too many of them, nothing more is received.
            self.waiting.retain(|(_, question)| question.is_awaited());
            let question = match self.leases.receive() {
                Ok(Some(question)) => question,
                Ok(None) => break,
                Err(why) => {
                    self.dropped_questions.note(why);
                    break;
                }
            };
            // Whatever the actor published before it asked is taken in before it is answered.
            self.take_trajectories()?;
            match self.hear(question.bytes()) {
                Ok(request) => self.waiting.push((request, question)),
                Err(why) => self.dropped_questions.note(format!("{why:#}")),
            }
        }
        self.waiting.retain(|(_, question)| question.is_awaited());
        while !self.waiting.is_empty() {
            let open = self.ledger.as_ref().is_some_and(LeaseLedger::has_open_leases);
            if !open && self.work != Work::IsDone {
                break;
            }
            let (request, question) = self.waiting.remove(0);
            // Leases for an actor that no longer waits would stay held until they are overdue.
            if !question.is_awaited() {
                continue;
            }
            let leases = self.grant(&request);
            let reply = LeaseReply { leases, finished: self.work == Work::IsDone };
            if let Err(why) = question.reply(&reply.encode_to_vec()) {
                self.dropped_questions.note(why);
                self.take_back(&request.actor, &reply.leases);
            }
        }
        Ok(())
    }

    /// Decodes an actor's request and notes what the actor reports.
    fn hear(&mut self, question: &[u8]) -> Result<LeaseRequest> {
        let request = LeaseRequest::decode(question).context("undecodable question")?;
        if !self.alive.contains(&request.actor) {
            self.alive = self.bus.alive()?;
        }
        if !self.alive.contains(&request.actor) {
            bail!("expected an actor of this bus, found `{}`", request.actor);
        }
        self.heard.note(&request.actor, 0);
        if let Some(seconds) = request.seconds.filter(ActorSeconds::is_possible) {
            self.actors.add(&seconds);
        }
        self.take_back(&request.actor, &request.finished);
        Ok(request)
    }

    fn take_back(&mut self, actor: &str, leases: &[Lease]) {
        if let Some(ledger) = &mut self.ledger {
            for lease in leases {
                ledger.hand_back(actor, lease);
            }
        }
    }

    fn grant(&mut self, request: &LeaseRequest) -> Vec<Lease> {
        let actors = self.actors();
        let Some(ledger) = &mut self.ledger else { return Vec::new() };
        ledger.grant(&request.actor, request.capacity as usize, actors, Instant::now())
    }

    fn hand_over_batch(&mut self) {
        if self.ledger.as_ref().is_some_and(LeaseLedger::is_complete)
            && let Some(ledger) = self.ledger.take()
        {
            // A trainer that is gone has failed and reports that itself.
            let actors = std::mem::take(&mut self.actors);
            self.rollouts.send(RolledOut { trajectories: ledger.into_batch(), actors }).ok();
        }
    }

    fn look_after_actors(&mut self) -> Result<()> {
        if self.looked_after.elapsed() < LOOK_AFTER_ACTORS {
            return Ok(());
        }
        self.looked_after = Instant::now();
        self.bus.clean_up();
        self.alive = self.bus.alive()?;
        self.heard.keep(&self.alive);
        let Some(ledger) = &mut self.ledger else { return Ok(()) };
        let lost = ledger.reopen_lost(&self.alive);
        if lost > 0 {
            tracing::warn!("{lost} leases of lost actors are open again");
        }
        let overdue = ledger.reopen_overdue(self.lease_timeout, Instant::now());
        if overdue > 0 {
            let seconds = self.lease_timeout.as_secs_f64();
            tracing::warn!(
                "{overdue} leases held longer than {seconds} s are open again: no others are left"
            );
        }
        Ok(())
    }

    fn actors(&self) -> usize {
        self.alive.iter().filter(|name| name.starts_with("actor")).count()
    }

    fn tell(&mut self) -> Result<()> {
        let ledger = self.ledger.as_ref();
        let mut progress = self.told.clone();
        progress.steps_received += ledger.map_or(0, LeaseLedger::steps);
        progress.actors = self.actors() as u32;
        progress.leases = ledger.map_or(0, LeaseLedger::held) as u32;
        progress.actors_heard = self.heard.told(ledger);
        progress.log_bytes = self.log.bytes_written();
        Ok(self.progress.publish(&progress.encode_to_vec())?)
    }
}
