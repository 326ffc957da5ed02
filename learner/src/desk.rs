//! The learner's desk: the thread that owns its ports and its log.
//!
//! It hands leases to actors, takes trajectories in, appends them to the log before anybody uses
//! them, and publishes weights and progress, all while the trainer computes. Trainer and desk talk
//! over two bounded channels: orders one way, complete batches the other.

use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow};
use prost::Message;
use protocol::Error;
use protocol::bus::{
    Bus, BusAddress, Doorbell, NewestPublisher, Request, Ringer, Role, Server, SharedMemory,
    TrajectorySubscriber,
};
use protocol::log::LogWriter;
use protocol::messages::{
    ActorSeconds, Checkpoint, Lease, LeaseReply, LeaseRequest, Phase, PolicyUpdate, Progress,
    RewardUpdate, Score,
};
use protocol::task::Spec;
use protocol::trajectory::Encoded;
use protocol::weights::Weights;

use crate::rollout::Rollout;

/// Orders that may wait; the trainer gives a handful per iteration.
const ORDERS: usize = 64;

/// Longest sleep, so that weights are refreshed for late actors in time.
const TICK: Duration = Duration::from_millis(20);

/// How often actors are looked after: the dead cleaned away, their leases opened again.
const LOOK_AFTER_ACTORS: Duration = Duration::from_millis(500);

/// How often the open log chunks are closed, so that a crash takes little.
const FLUSH_LOG: Duration = Duration::from_secs(1);

/// How long a refusing disk is left alone before it is tried again.
pub(crate) const DISK_PATIENCE: Duration = Duration::from_secs(1);

/// Room for a progress message.
const PROGRESS_BYTES: usize = 64 << 10;

/// What the trainer orders.
pub enum Order {
    /// Roll out; the batch comes back when it is complete.
    Open(Rollout),
    /// Publish a version of the policy.
    Publish(Weights),
    /// Append to the log.
    Record(Entry),
    /// Publish how the run stands; the desk fills in what it knows better.
    Tell(Progress),
    /// Put everything appended so far on the disk and answer.
    Sync(SyncSender<()>),
    /// Tell the actors that the run is over, seal the log and end.
    Finish,
}

/// What the trainer has recorded.
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

/// Where the time of actors and log went in one sitting, seconds.
#[derive(Clone, Copy, Debug, Default)]
pub struct DeskSeconds {
    /// Of all actors together.
    pub actors: ActorSeconds,
    /// In appending to the log.
    pub log: f64,
}

/// What the desk needs to open.
pub struct Setup {
    /// The run's bus.
    pub address: BusAddress,
    /// Shapes of the task.
    pub spec: Spec,
    /// Longest encoded weights.
    pub weights_bytes: usize,
    /// A lease held longer is handed out again.
    pub lease_timeout: Duration,
    /// The run's log, open.
    pub log: LogWriter,
}

/// The trainer's end of the desk.
pub struct DeskHandle {
    orders: SyncSender<Order>,
    batches: Receiver<Vec<Encoded>>,
    ringer: std::rc::Rc<Ringer<SharedMemory>>,
    thread: Option<JoinHandle<Result<DeskSeconds>>>,
}

impl DeskHandle {
    /// Starts the desk; `bus` is the trainer's own, over which it rings the desk.
    pub fn start(setup: Setup, bus: &Bus) -> Result<DeskHandle> {
        let (orders, incoming) = sync_channel(ORDERS);
        let (outgoing, batches) = sync_channel(1);
        let (ready, opened) = sync_channel(1);
        let body = move || {
            let mut desk = Desk::open(setup, incoming, outgoing)?;
            // The trainer may have gone; then the first order says so.
            ready.send(()).ok();
            desk.run()
        };
        let thread = std::thread::Builder::new().name("desk".to_owned()).spawn(body)?;
        let ringer = bus.ringer(Role::Learner)?;
        let mut handle = DeskHandle { orders, batches, ringer, thread: Some(thread) };
        match opened.recv() {
            Ok(()) => Ok(handle),
            Err(_) => Err(handle.failure()),
        }
    }

    /// Gives an order.
    pub fn order(&mut self, order: Order) -> Result<()> {
        if self.orders.send(order).is_err() {
            return Err(self.failure());
        }
        Ok(self.ringer.ring()?)
    }

    /// The next complete batch, if it comes within `patience`.
    pub fn batch(&mut self, patience: Duration) -> Result<Option<Vec<Encoded>>> {
        use std::sync::mpsc::RecvTimeoutError::{Disconnected, Timeout};
        match self.batches.recv_timeout(patience) {
            Ok(batch) => Ok(Some(batch)),
            Err(Timeout) => Ok(None),
            Err(Disconnected) => Err(self.failure()),
        }
    }

    /// Returns when everything recorded so far is on the disk.
    pub fn sync(&mut self) -> Result<()> {
        let (done, synced) = sync_channel(1);
        self.order(Order::Sync(done))?;
        if synced.recv().is_err() {
            return Err(self.failure());
        }
        Ok(())
    }

    /// Ends the desk and waits for it; says where the time went.
    pub fn finish(mut self) -> Result<DeskSeconds> {
        self.order(Order::Finish)?;
        self.join()
    }

    fn failure(&mut self) -> anyhow::Error {
        self.join().err().unwrap_or_else(|| anyhow!("the desk ended before the run"))
    }

    fn join(&mut self) -> Result<DeskSeconds> {
        let Some(thread) = self.thread.take() else { return Ok(DeskSeconds::default()) };
        // The panic itself has been printed by the thread.
        thread.join().unwrap_or_else(|_| Err(anyhow!("the desk panicked")))
    }
}

struct Desk {
    spec: Spec,
    lease_timeout: Duration,
    bus: Bus,
    doorbell: Doorbell<SharedMemory>,
    trajectories: TrajectorySubscriber<SharedMemory>,
    leases: Server<SharedMemory>,
    weights: NewestPublisher<SharedMemory>,
    progress: NewestPublisher<SharedMemory>,
    log: LogWriter,
    orders: Receiver<Order>,
    batches: SyncSender<Vec<Encoded>>,
    rollout: Option<Rollout>,
    /// Actors that wait for leases; they are answered when there are some.
    waiting: Vec<(LeaseRequest, Request<SharedMemory>)>,
    told: Progress,
    alive: Vec<String>,
    looked_after: Instant,
    flushed: Instant,
    finished: bool,
    seconds: DeskSeconds,
}

impl Desk {
    fn open(
        setup: Setup,
        orders: Receiver<Order>,
        batches: SyncSender<Vec<Encoded>>,
    ) -> Result<Desk> {
        let bus = Bus::open(&setup.address, "learner")?;
        Ok(Desk {
            spec: setup.spec,
            lease_timeout: setup.lease_timeout,
            doorbell: bus.doorbell(Role::Learner)?,
            trajectories: bus.trajectory_subscriber()?,
            leases: bus.lease_server()?,
            weights: bus.weights_publisher(setup.weights_bytes)?,
            progress: bus.progress_publisher(PROGRESS_BYTES)?,
            log: setup.log,
            orders,
            batches,
            rollout: None,
            waiting: Vec::new(),
            told: Progress::default(),
            alive: bus.alive()?,
            looked_after: Instant::now(),
            flushed: Instant::now(),
            finished: false,
            seconds: DeskSeconds::default(),
            bus,
        })
    }

    fn run(&mut self) -> Result<DeskSeconds> {
        while !self.finished {
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
        self.answer_actors()?;
        self.complete(LogWriter::finish)?;
        Ok(self.seconds)
    }

    /// Appends to the log, and counts the time it takes. When the disk refuses, the message is
    /// kept in memory: the run pauses until it is written.
    fn append(&mut self, append: impl FnOnce(&mut LogWriter) -> Result<(), Error>) -> Result<()> {
        let begun = Instant::now();
        if let Err(error) = append(&mut self.log) {
            self.wait_for_room(&error)?;
            self.complete(LogWriter::flush)?;
        }
        self.seconds.log += begun.elapsed().as_secs_f64();
        Ok(())
    }

    /// Flushes, syncs or seals the log, however long the disk refuses.
    fn complete(&mut self, write: impl Fn(&mut LogWriter) -> Result<(), Error>) -> Result<()> {
        while let Err(error) = write(&mut self.log) {
            self.wait_for_room(&error)?;
        }
        Ok(())
    }

    fn wait_for_room(&mut self, error: &Error) -> Result<()> {
        tracing::error!("paused until the log can be written: {error}");
        let phase = std::mem::replace(&mut self.told.phase, Phase::DiskFull as i32);
        self.tell()?;
        self.told.phase = phase;
        std::thread::sleep(DISK_PATIENCE);
        Ok(())
    }

    fn take_orders(&mut self) -> Result<()> {
        loop {
            match self.orders.try_recv() {
                Ok(order) => self.follow(order)?,
                Err(TryRecvError::Empty) => return Ok(()),
                Err(TryRecvError::Disconnected) => {
                    self.finished = true;
                    return Ok(());
                }
            }
        }
    }

    fn follow(&mut self, order: Order) -> Result<()> {
        match order {
            Order::Open(rollout) => self.rollout = Some(rollout),
            Order::Publish(weights) => self.weights.publish(&weights.encode_to_vec())?,
            Order::Record(entry) => self.record(&entry)?,
            Order::Tell(progress) => {
                self.told = progress;
                self.tell()?;
            }
            Order::Sync(done) => {
                self.complete(LogWriter::sync)?;
                // A trainer that no longer waits has failed and says why itself.
                done.send(()).ok();
            }
            Order::Finish => self.finished = true,
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

    /// Appends what actors published, then takes it into the rollout.
    fn take_trajectories(&mut self) -> Result<()> {
        while let Some((_, bytes)) = self.trajectories.receive()? {
            let encoded = Encoded::decode(bytes, &self.spec).context("from an actor")?;
            let Some(rollout) = &mut self.rollout else { continue };
            if rollout.receive(encoded.clone())? {
                self.append(|log| log.trajectory(&encoded))?;
            }
        }
        Ok(())
    }

    fn answer_actors(&mut self) -> Result<()> {
        while let Some(question) = self.leases.receive()? {
            // Whatever the asker published before it asked is taken in before it is answered.
            self.take_trajectories()?;
            let request = LeaseRequest::decode(question.bytes()).context("lease request")?;
            self.hear(&request)?;
            self.waiting.push((request, question));
        }
        self.waiting.retain(|(_, question)| question.is_awaited());
        while !self.waiting.is_empty() {
            let open = self.rollout.as_ref().is_some_and(Rollout::has_open_leases);
            if !open && !self.finished {
                break;
            }
            let (request, question) = self.waiting.remove(0);
            let leases = self.grant(&request);
            let reply = LeaseReply { leases, finished: self.finished };
            question.reply(&reply.encode_to_vec())?;
        }
        Ok(())
    }

    /// Takes note of what an actor says of itself.
    fn hear(&mut self, request: &LeaseRequest) -> Result<()> {
        if !self.alive.contains(&request.actor) {
            self.alive = self.bus.alive()?;
        }
        if let Some(seconds) = request.seconds {
            self.seconds.actors.environment += seconds.environment;
            self.seconds.actors.inference += seconds.inference;
            self.seconds.actors.transport += seconds.transport;
        }
        if let Some(rollout) = &mut self.rollout {
            for lease in &request.finished {
                rollout.hand_back(&request.actor, lease);
            }
        }
        Ok(())
    }

    fn grant(&mut self, request: &LeaseRequest) -> Vec<Lease> {
        let actors = self.actors();
        let Some(rollout) = &mut self.rollout else { return Vec::new() };
        rollout.grant(&request.actor, request.capacity as usize, actors, Instant::now())
    }

    fn hand_over_batch(&mut self) {
        if self.rollout.as_ref().is_some_and(Rollout::is_complete)
            && let Some(rollout) = self.rollout.take()
        {
            // A trainer that is gone has failed and says why itself.
            self.batches.send(rollout.into_batch()).ok();
        }
    }

    fn look_after_actors(&mut self) -> Result<()> {
        if self.looked_after.elapsed() < LOOK_AFTER_ACTORS {
            return Ok(());
        }
        self.looked_after = Instant::now();
        self.bus.clean_up();
        self.alive = self.bus.alive()?;
        let Some(rollout) = &mut self.rollout else { return Ok(()) };
        let reopened = rollout.reopen(&self.alive, self.lease_timeout, Instant::now());
        if reopened > 0 {
            tracing::warn!("{reopened} leases of lost actors are open again");
        }
        Ok(())
    }

    fn actors(&self) -> usize {
        self.alive.iter().filter(|name| name.starts_with("actor")).count()
    }

    fn tell(&mut self) -> Result<()> {
        let rollout = self.rollout.as_ref();
        let mut progress = self.told.clone();
        progress.steps_received += rollout.map_or(0, Rollout::steps);
        progress.actors = self.actors() as u32;
        progress.leases = rollout.map_or(0, Rollout::held) as u32;
        progress.log_bytes = self.log.bytes_written();
        Ok(self.progress.publish(&progress.encode_to_vec())?)
    }
}
