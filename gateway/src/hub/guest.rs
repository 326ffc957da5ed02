//! A host at the hub: the thread that acts for it on the learner's bus.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use bus::{Bus, BusAddress, MAX_ACTORS, TrajectoryHeader, TrajectoryPublisher};
use bytes::Bytes;
use protocol::dropped::{Dropped, shortened};
use protocol::messages::{LeaseReply, LeaseRequest};
use protocol::task::Spec;
use protocol::trajectory::Encoded;
use run::folder::RunFolder;
use tokio::sync::oneshot;

use super::is_name;
use super::stand_in::StandIn;
use crate::messages::Answer;

/// Orders of one host that may wait.
const ORDERS: usize = 256;

/// How often answers are looked for while questions are open.
const POLL: Duration = Duration::from_millis(1);

/// How long the thread sleeps otherwise.
const IDLE: Duration = Duration::from_millis(250);

/// A host that has not been heard of for so long is gone.
const PATIENCE: Duration = Duration::from_secs(4);

/// Longest name of an actor: the bus takes 128 with the host's.
const NAME_BYTES: usize = 80;

/// How long the full queue of the learner or the service is waited for.
const READER_PATIENCE: Duration = Duration::from_secs(2);

/// What every host's thread needs.
#[derive(Clone, Debug)]
pub(super) struct GuestSetup {
    pub(super) folder: RunFolder,
    pub(super) spec: Spec,
    pub(super) run_seed: u64,
}

/// What a host wants, and who waits for it.
pub(super) enum Order {
    /// To be known to live, with these actors.
    Beat { actors: Vec<String>, done: oneshot::Sender<()> },
    /// Leases.
    Ask { number: u64, request: LeaseRequest, done: oneshot::Sender<Result<Answer>> },
    /// A trajectory to be published; an error is the host's fault.
    Deliver { trajectory: Bytes, done: oneshot::Sender<Result<()>> },
}

/// A host that has joined.
pub(super) struct Guest {
    host: String,
    orders: SyncSender<Order>,
    thread: JoinHandle<()>,
}

impl Guest {
    /// Starts its thread.
    ///
    /// # Errors
    /// When the run's bus is not there, or the thread cannot start.
    pub(super) fn start(setup: &GuestSetup, host: &str) -> Result<Guest> {
        let (orders, incoming) = sync_channel(ORDERS);
        let (setup, name) = (setup.clone(), host.to_owned());
        let address = BusAddress::of_run(setup.folder.path())?;
        let body = move || {
            let work = Work::open(setup, address, &name);
            match work.and_then(|mut work| work.run(&incoming)) {
                Ok(()) => tracing::info!("host {name} has left"),
                Err(error) => tracing::error!("host {name} is given up: {error:#}"),
            }
        };
        let thread = std::thread::Builder::new().name("host".to_owned()).spawn(body);
        let thread = thread.context("starting a thread")?;
        Ok(Guest { host: host.to_owned(), orders, thread })
    }

    /// Whether it has not left.
    pub(super) fn is_there(&self) -> bool {
        !self.thread.is_finished()
    }

    pub(super) fn host(&self) -> &str {
        &self.host
    }

    /// Gives an order; returns whether there was room for it. Of a host that has left nothing comes.
    pub(super) fn order(&self, order: Order) -> bool {
        !matches!(self.orders.try_send(order), Err(TrySendError::Full(_)))
    }
}

/// A host's thread at work.
struct Work {
    setup: GuestSetup,
    address: BusAddress,
    host: String,
    bus: Bus,
    trajectories: TrajectoryPublisher,
    stand_ins: BTreeMap<String, StandIn>,
    /// Source, iteration and lane of leases that the host was granted.
    granted: BTreeSet<(i32, u64, u64)>,
    heard: Instant,
    dropped: Dropped,
}

impl Work {
    fn open(setup: GuestSetup, address: BusAddress, host: &str) -> Result<Work> {
        let bus = Bus::open(&address, &format!("gateway@{host}"))?;
        Ok(Work {
            setup,
            address,
            host: host.to_owned(),
            trajectories: bus.rollout_publisher(READER_PATIENCE)?,
            bus,
            stand_ins: BTreeMap::new(),
            granted: BTreeSet::new(),
            heard: Instant::now(),
            dropped: Dropped::new("trajectories of leases that a host did not hold"),
        })
    }

    /// Works until the host is gone.
    fn run(&mut self, orders: &Receiver<Order>) -> Result<()> {
        while self.heard.elapsed() < PATIENCE {
            let is_open = self.stand_ins.values().any(StandIn::is_waited_for);
            match orders.recv_timeout(if is_open { POLL } else { IDLE }) {
                Ok(order) => self.follow(order)?,
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return Ok(()),
            }
            self.look_for_answers();
        }
        Ok(())
    }

    fn follow(&mut self, order: Order) -> Result<()> {
        self.heard = Instant::now();
        match order {
            Order::Beat { actors, done } => {
                self.stand_ins.retain(|actor, _| actors.contains(actor));
                done.send(()).ok();
            }
            Order::Ask { number, request, done } => match self.stand_in(&request.actor) {
                Ok(stand_in) => stand_in.ask(number, request, done),
                Err(why) => {
                    done.send(Err(why)).ok();
                }
            },
            Order::Deliver { trajectory, done } => {
                let checked = self.checked(trajectory);
                if let Ok(encoded) = &checked {
                    self.publish(encoded)?;
                }
                done.send(checked.map(drop)).ok();
            }
        }
        Ok(())
    }

    /// The actor that stands on this bus for one of the host.
    fn stand_in(&mut self, actor: &str) -> Result<&mut StandIn> {
        if !self.stand_ins.contains_key(actor) {
            ensure!(
                is_actor(actor),
                "expected the name of an actor, found {}",
                shortened(actor, 40)
            );
            let actors = self.bus.alive()?.iter().filter(|name| name.starts_with("actor")).count();
            ensure!(
                actors < MAX_ACTORS,
                "expected at most {MAX_ACTORS} actors of a run, found another one of {}",
                self.host
            );
            let name = format!("{actor}@{}", self.host);
            let stand_in = StandIn::open(&self.setup.folder, &self.address, name)?;
            self.stand_ins.insert(actor.to_owned(), stand_in);
        }
        self.stand_ins.get_mut(actor).context("an actor that was just taken on")
    }

    /// A trajectory that is one of this run.
    fn checked(&self, bytes: Bytes) -> Result<Encoded> {
        let encoded = Encoded::decode(bytes, &self.setup.spec)?;
        let (expected, found) = (self.setup.run_seed, encoded.trajectory.run_seed);
        ensure!(expected == found, "trajectory: expected run seed {expected}, found {found}");
        Ok(encoded)
    }

    /// Publishes a trajectory, if the host was granted its lease. One of a lease that it held before it was
    /// away for long is not: others have that.
    fn publish(&mut self, encoded: &Encoded) -> Result<()> {
        let trajectory = &encoded.trajectory;
        let name = (trajectory.source, trajectory.iteration, trajectory.lane);
        if !self.granted.contains(&name) {
            self.dropped.note(format!("host {}: lane {}", self.host, trajectory.lane));
            return Ok(());
        }
        self.trajectories.publish(&encoded.bytes, TrajectoryHeader::from(encoded))?;
        Ok(())
    }

    fn look_for_answers(&mut self) {
        for stand_in in self.stand_ins.values_mut() {
            if let Some(reply) = stand_in.look() {
                note_granted(&mut self.granted, &reply);
            }
        }
    }
}

fn is_actor(name: &str) -> bool {
    name.starts_with("actor") && is_name(name, NAME_BYTES)
}

/// Remembers leases, and forgets those before the iteration that may still be under way.
fn note_granted(granted: &mut BTreeSet<(i32, u64, u64)>, reply: &LeaseReply) {
    for lease in &reply.leases {
        granted.retain(|(_, iteration, _)| iteration + 1 >= lease.iteration);
        granted.insert((lease.source, lease.iteration, lease.lane));
    }
}
