//! A host at the hub: the thread that acts for it on the learner's bus.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, TrySendError, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use bus::{Bus, BusAddress, Doorbell, Role, Sleeper, TrajectoryHeader, TrajectoryPublisher};
use bytes::Bytes;
use protocol::MAX_ACTORS;
use protocol::dropped::{Dropped, shortened};
use protocol::messages::LeaseReply;
use protocol::task::Spec;
use protocol::trajectory::Encoded;
use run::folder::RunFolder;
use run::hosts::Host;
use tokio::sync::{mpsc, oneshot};

use super::is_name;
use super::stand_in::{Refusal, StandIn};
use crate::messages::{Answer, Exchange, Hello};

/// Orders of one host that may wait.
const ORDERS: usize = 256;

/// Longest sleep, so that a host that is gone is noticed, and one that waits is told in time.
const TICK: Duration = Duration::from_millis(250);

/// A host that has not been heard of for so long is gone.
const PATIENCE: Duration = Duration::from_secs(4);

/// Longest name of an actor: the bus takes 128 with the host's.
const NAME_BYTES: usize = 80;

/// Longest name of a build, characters.
const BUILD_CHARS: usize = 200;

/// How long the full queue of the learner or the service is waited for.
const READER_PATIENCE: Duration = Duration::from_secs(2);

/// What every host's thread needs.
#[derive(Clone, Debug)]
pub(super) struct GuestSetup {
    pub(super) folder: RunFolder,
    pub(super) spec: Spec,
    pub(super) run_seed: u64,
    /// Takes whom to wake.
    pub(super) wake: mpsc::Sender<Sleeper>,
}

/// What a host wants, and who waits for it.
pub(super) enum Order {
    /// To be known to live, with these actors.
    Beat { actors: Vec<String>, done: oneshot::Sender<()> },
    /// Its trajectories published, and then leases, if it asks for them.
    Exchange { exchange: Exchange, done: oneshot::Sender<Result<Answer, Refusal>> },
}

/// A host that has joined.
pub(super) struct Guest {
    /// What there is to say of it.
    pub(super) about: Host,
    /// How many actors it is to have.
    pub(super) actors: u64,
    orders: SyncSender<Order>,
    thread: JoinHandle<()>,
    sleeper: Sleeper,
    wake: mpsc::Sender<Sleeper>,
}

impl Guest {
    /// Starts its thread.
    ///
    /// # Errors
    /// When the run's bus is not there, or the thread cannot start.
    pub(super) fn start(setup: &GuestSetup, host: &str, hello: &Hello) -> Result<Guest> {
        let (orders, incoming) = sync_channel(ORDERS);
        let (opened, sleeper) = sync_channel(1);
        let (work, name) = (setup.clone(), host.to_owned());
        let body = move || match Work::open(work, &name) {
            Ok(mut work) => {
                opened.send(Ok(work.doorbell.sleeper())).ok();
                match work.run(&incoming) {
                    Ok(()) => tracing::info!("host {name} has left"),
                    Err(error) => tracing::error!("host {name} is given up: {error:#}"),
                }
            }
            Err(error) => {
                opened.send(Err(error)).ok();
            }
        };
        let thread = std::thread::Builder::new().name("host".to_owned()).spawn(body);
        let thread = thread.context("starting a thread")?;
        let sleeper = sleeper.recv().context("opening the bus")??;
        let wake = setup.wake.clone();
        let build = shortened(&hello.build, BUILD_CHARS);
        let about = Host { name: host.to_owned(), build, actors: 0, distance_ms: None };
        Ok(Guest { about, actors: hello.actors, orders, thread, sleeper, wake })
    }

    /// Whether it has not left.
    pub(super) fn is_there(&self) -> bool {
        !self.thread.is_finished()
    }

    /// How many places of the run it takes.
    pub(super) fn places(&self) -> u64 {
        places(self.actors)
    }

    pub(super) fn host(&self) -> &str {
        &self.about.name
    }

    /// Gives an order; returns whether there was room for it. Of a host that has left nothing comes.
    pub(super) fn order(&self, order: Order) -> bool {
        let has_room = !matches!(self.orders.try_send(order), Err(TrySendError::Full(_)));
        // Where others are woken already, it wakes by itself soon.
        self.wake.try_send(self.sleeper).ok();
        has_room
    }
}

/// How many places of a run a host of so many actors takes: at least one, so that there are no more hosts than
/// actors.
pub(super) fn places(actors: u64) -> u64 {
    actors.max(1)
}

/// A host's thread at work.
struct Work {
    setup: GuestSetup,
    address: BusAddress,
    host: String,
    bus: Bus,
    doorbell: Doorbell,
    trajectories: TrajectoryPublisher,
    stand_ins: BTreeMap<String, StandIn>,
    /// Source, iteration and lane of leases that the host was granted.
    granted: BTreeSet<(i32, u64, u64)>,
    heard: Instant,
    dropped: Dropped,
    /// What actors ask that have no place on this bus; they ask again.
    placeless: Dropped,
}

impl Work {
    fn open(setup: GuestSetup, host: &str) -> Result<Work> {
        let address = BusAddress::of_run(setup.folder.path())?;
        let bus = Bus::open(&address, &format!("gateway@{host}"))?;
        Ok(Work {
            setup,
            address,
            host: host.to_owned(),
            doorbell: bus.doorbell(Role::Actors)?,
            trajectories: bus.rollout_publisher(READER_PATIENCE)?,
            bus,
            stand_ins: BTreeMap::new(),
            granted: BTreeSet::new(),
            heard: Instant::now(),
            dropped: Dropped::new("trajectories of leases that a host did not hold"),
            placeless: Dropped::new("requests of a host's actors that have no place"),
        })
    }

    /// Works until the host is gone.
    fn run(&mut self, orders: &Receiver<Order>) -> Result<()> {
        while self.heard.elapsed() < PATIENCE {
            self.doorbell.wait(TICK)?;
            loop {
                match orders.try_recv() {
                    Ok(order) => self.follow(order)?,
                    Err(TryRecvError::Empty) => break,
                    Err(TryRecvError::Disconnected) => return Ok(()),
                }
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
            Order::Exchange { exchange, done } => self.exchange(exchange, done)?,
        }
        Ok(())
    }

    fn exchange(
        &mut self,
        exchange: Exchange,
        done: oneshot::Sender<Result<Answer, Refusal>>,
    ) -> Result<()> {
        let Exchange { trajectories, number, request, .. } = exchange;
        let checked = trajectories.into_iter().map(|trajectory| self.checked(trajectory));
        match checked.collect::<Result<Vec<Encoded>>>() {
            Ok(checked) => self.publish(&checked)?,
            Err(why) => {
                done.send(Err(Refusal::Wrong(why))).ok();
                return Ok(());
            }
        }
        let Some(request) = request else {
            done.send(Ok(Answer::default())).ok();
            return Ok(());
        };
        match self.stand_in(&request.actor) {
            Ok(stand_in) => stand_in.ask(number, request, done),
            Err(why) => {
                self.placeless.note(format!("host {}: {why:#}", self.host));
                done.send(Err(Refusal::NoRoom(why))).ok();
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
            let stand_in = StandIn::open(&self.setup.folder, &self.address, name, &self.doorbell)?;
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

    /// Publishes trajectories, those of leases that the host was granted. One of a lease that it held before it
    /// was away for long is not: others have that.
    fn publish(&mut self, trajectories: &[Encoded]) -> Result<()> {
        trajectories.iter().try_for_each(|encoded| self.send(encoded))?;
        if !trajectories.is_empty() {
            self.trajectories.ring()?;
        }
        Ok(())
    }

    fn send(&mut self, encoded: &Encoded) -> Result<()> {
        let trajectory = &encoded.trajectory;
        let name = (trajectory.source, trajectory.iteration, trajectory.lane);
        if !self.granted.contains(&name) {
            self.dropped.note(format!("host {}: lane {}", self.host, trajectory.lane));
            return Ok(());
        }
        self.trajectories.send(&encoded.bytes, TrajectoryHeader::from(encoded))?;
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
