//! A host at the hub: the thread that acts for it on the learner's bus.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, TrySendError, sync_channel};
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use bus::{Bus, BusAddress, Doorbell, Role, Sleeper, TrajectoryHeader, TrajectoryPublisher};
use bytes::Bytes;
use prost::Message;
use protocol::MAX_ACTORS;
use protocol::dropped::{Dropped, shortened};
use protocol::messages::{LeaseReply, LeaseRequest};
use protocol::task::Spec;
use protocol::trajectory::Encoded;
use run::folder::RunFolder;
use run::hosts::Host;
use tokio::sync::{mpsc, oneshot};

use super::is_name;
use super::stand_in::{Refusal, StandIn};
use crate::messages::{Answer, Exchange, Hello};

/// Number of orders of one host that may wait.
const ORDERS: usize = 256;

/// Longest sleep, so that a vanished host is noticed and a waiting host gets its reply in time.
const TICK: Duration = Duration::from_millis(250);

/// A host that has not been heard of for this long is gone.
const PATIENCE: Duration = Duration::from_secs(4);

/// Longest name of an actor, bytes: with the host's name it has to fit into the bus's limit of 128.
const NAME_BYTES: usize = 80;

/// Longest build name that is kept or told, characters.
pub(super) const BUILD_CHARS: usize = 200;

/// Longest part of a host's text in a message, characters.
const SHOWN_CHARS: usize = 40;

/// How long to wait for the full queue of the learner or the proximity service.
const READER_PATIENCE: Duration = Duration::from_secs(2);

/// What the threads of all hosts need.
#[derive(Clone, Debug)]
pub(super) struct GuestSetup {
    pub(super) folder: RunFolder,
    /// Name of the run's task.
    pub(super) task: String,
    pub(super) spec: Spec,
    pub(super) run_seed: u64,
    /// Takes the threads that are to be woken.
    pub(super) wake: mpsc::Sender<Sleeper>,
    /// Held by every thread.
    pub(super) threads: Arc<()>,
}

impl GuestSetup {
    /// Returns how many threads there are.
    pub(super) fn threads(&self) -> usize {
        Arc::strong_count(&self.threads) - 1
    }
}

/// A host's order, with the channel for its outcome.
pub(super) enum Order {
    /// Note that the host is alive, with these actors.
    Beat { actors: Vec<String>, done: oneshot::Sender<()> },
    /// Publish the host's trajectories, and then request leases if it asks for them.
    Exchange { exchange: Exchange, done: oneshot::Sender<Result<Answer, Refusal>> },
    /// End.
    Leave,
}

/// Tells when a host's thread has opened the bus, or why it cannot.
pub(super) type Opened = oneshot::Receiver<Result<()>>;

/// A host that has joined.
pub(super) struct Guest {
    /// What the run's folder says about the host.
    pub(super) about: Host,
    /// Number of actors that it is to run.
    actors: Arc<AtomicU64>,
    orders: SyncSender<Order>,
    thread: JoinHandle<()>,
    /// The thread, once it has opened the bus.
    sleeper: Arc<OnceLock<Sleeper>>,
    wake: mpsc::Sender<Sleeper>,
}

impl Guest {
    /// Starts the host's thread, which opens the bus by itself: that may take seconds.
    ///
    /// # Errors
    /// When the thread cannot start.
    pub(super) fn start(setup: &GuestSetup, host: &str, hello: &Hello) -> Result<(Guest, Opened)> {
        let (orders, incoming) = sync_channel(ORDERS);
        let (told, opened) = oneshot::channel();
        let sleeper = Arc::new(OnceLock::new());
        let actors = Arc::new(AtomicU64::new(hello.actors));
        let (work, name, own) = (setup.clone(), host.to_owned(), Arc::clone(&sleeper));
        let wanted = Arc::clone(&actors);
        let body = move || match Work::open(work, &name, wanted) {
            Ok(mut work) => {
                own.set(work.doorbell.sleeper()).ok();
                told.send(Ok(())).ok();
                match work.run(&incoming) {
                    Ok(()) => tracing::info!("host {name} has left"),
                    Err(error) => tracing::error!("host {name} is given up: {error:#}"),
                }
            }
            Err(error) => {
                told.send(Err(error)).ok();
            }
        };
        let thread = std::thread::Builder::new().name("host".to_owned()).spawn(body);
        let thread = thread.context("starting a thread")?;
        let wake = setup.wake.clone();
        let build = shortened(&hello.build, BUILD_CHARS);
        let about = Host { name: host.to_owned(), build, actors: 0, distance_ms: None };
        let guest = Guest { about, actors, orders, thread, sleeper, wake };
        Ok((guest, opened))
    }

    /// Returns whether the host has not left.
    pub(super) fn is_there(&self) -> bool {
        !self.thread.is_finished()
    }

    /// Returns how many actors the host is to run.
    pub(super) fn actors(&self) -> u64 {
        self.actors.load(Ordering::Relaxed)
    }

    /// Changes how many actors the host is to run.
    pub(super) fn scale(&self, actors: u64) {
        self.actors.store(actors, Ordering::Relaxed);
    }

    /// Returns how many of the run's places for actors the host takes.
    pub(super) fn places(&self) -> u64 {
        places(self.actors())
    }

    pub(super) fn host(&self) -> &str {
        &self.about.name
    }

    /// Gives an order; returns whether there was room for it. Orders to a host that has left have no outcome.
    pub(super) fn order(&self, order: Order) -> bool {
        let has_room = !matches!(self.orders.try_send(order), Err(TrySendError::Full(_)));
        if let Some(sleeper) = self.sleeper.get() {
            // If the channel is full, the thread wakes soon by itself.
            self.wake.try_send(*sleeper).ok();
        }
        has_room
    }
}

impl Drop for Guest {
    /// Ends the thread at once: it holds places on the bus that others need.
    fn drop(&mut self) {
        self.order(Order::Leave);
    }
}

/// Returns how many of the run's places for actors a host with `actors` actors takes: at least one, so that there are
/// never more hosts than places.
pub(super) fn places(actors: u64) -> u64 {
    actors.max(1)
}

/// The state of a host's thread.
struct Work {
    setup: GuestSetup,
    address: BusAddress,
    host: String,
    /// Number of actors that the host is to run.
    actors: Arc<AtomicU64>,
    bus: Bus,
    doorbell: Doorbell,
    trajectories: TrajectoryPublisher,
    stand_ins: BTreeMap<String, StandIn>,
    /// Source, iteration and lane of the leases that the host was granted.
    granted: BTreeSet<(i32, u64, u64)>,
    heard: Instant,
    dropped: Dropped,
    /// Requests of actors for which this bus has no place; they are repeated.
    placeless: Dropped,
}

impl Work {
    fn open(setup: GuestSetup, host: &str, actors: Arc<AtomicU64>) -> Result<Work> {
        let address = BusAddress::of_run(setup.folder.path())?;
        let bus = Bus::open(&address, &format!("gateway@{host}"))?;
        Ok(Work {
            setup,
            address,
            host: host.to_owned(),
            actors,
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
            loop {
                match orders.try_recv() {
                    Ok(Order::Leave) | Err(TryRecvError::Disconnected) => return Ok(()),
                    Ok(Order::Beat { actors, done }) => {
                        self.heard = Instant::now();
                        self.stand_ins.retain(|actor, _| actors.contains(actor));
                        done.send(()).ok();
                    }
                    Ok(Order::Exchange { exchange, done }) => {
                        self.heard = Instant::now();
                        self.exchange(exchange, done)?;
                    }
                    Err(TryRecvError::Empty) => break,
                }
            }
            self.look_for_answers();
            self.doorbell.wait(TICK)?;
        }
        Ok(())
    }

    fn exchange(
        &mut self,
        exchange: Exchange,
        done: oneshot::Sender<Result<Answer, Refusal>>,
    ) -> Result<()> {
        let number = exchange.number;
        let (checked, request) = match self.read(exchange) {
            Ok(read) => read,
            Err(why) => {
                done.send(Err(Refusal::Wrong(why))).ok();
                return Ok(());
            }
        };
        self.publish(&checked)?;
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

    /// Returns the stand-in for an actor of the host, and opens it if there is none yet.
    fn stand_in(&mut self, actor: &str) -> Result<&mut StandIn> {
        if !self.stand_ins.contains_key(actor) {
            ensure!(
                is_actor(actor),
                "expected the name of an actor, found {}",
                shortened(actor, SHOWN_CHARS)
            );
            // Those that have just been replaced count, too, until the host's next beat.
            let most = 2 * places(self.actors.load(Ordering::Relaxed));
            ensure!(
                (self.stand_ins.len() as u64) < most,
                "expected no more than {most} actors of {} at once, found another one",
                self.host
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

    /// Decodes and checks what a host has sent.
    fn read(&self, exchange: Exchange) -> Result<(Vec<Encoded>, Option<LeaseRequest>)> {
        let request = exchange.asked()?;
        let checked = exchange.trajectories.into_iter().map(|trajectory| self.checked(trajectory));
        Ok((checked.collect::<Result<_>>()?, request))
    }

    /// Decodes a trajectory and checks that it is one of this run, encoded as an actor does.
    fn checked(&self, bytes: Bytes) -> Result<Encoded> {
        let encoded = Encoded::decode(bytes, &self.setup.spec)?;
        let trajectory = &encoded.trajectory;
        let (expected, found) = (self.setup.run_seed, trajectory.run_seed);
        ensure!(expected == found, "trajectory: expected run seed {expected}, found {found}");
        let (expected, found) = (&self.setup.task, &trajectory.task);
        ensure!(
            expected == found,
            "trajectory: expected task {expected}, found {}",
            shortened(found, SHOWN_CHARS)
        );
        // Decoding passes over unknown fields, but the run's log would keep them.
        ensure!(
            trajectory.encode_to_vec() == encoded.bytes,
            "trajectory: expected the {} bytes of its content, found {}",
            trajectory.encoded_len(),
            encoded.bytes.len()
        );
        Ok(encoded)
    }

    /// Publishes the trajectories that belong to leases granted to the host. Others are dropped, such as those of
    /// leases from before a long absence, which have been granted to other hosts.
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

/// Remembers granted leases. It forgets those more than one iteration older, because no older iteration can be under
/// way.
fn note_granted(granted: &mut BTreeSet<(i32, u64, u64)>, reply: &LeaseReply) {
    for lease in &reply.leases {
        granted.retain(|(_, iteration, _)| iteration + 1 >= lease.iteration);
        granted.insert((lease.source, lease.iteration, lease.lane));
    }
}
