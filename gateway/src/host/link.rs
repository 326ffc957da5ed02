//! The link of a host to the hub: it carries out the desk's orders by calls, several at once.

use std::cell::RefCell;
use std::collections::{BTreeSet, VecDeque};
use std::rc::Rc;
use std::sync::Arc;
use std::sync::mpsc::SyncSender;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use bus::{Bus, BusAddress, POLICY_VERSIONS, Ringer, Role};
use bytes::Bytes;
use prost::Message;
use protocol::messages::LeaseReply;
use run::actors_wanted::ActorsWanted;
use run::folder::RunFolder;
use run::process::Stop;
use tokio::sync::mpsc::Receiver;
use tokio::sync::{Mutex, Semaphore};
use tokio::task::LocalSet;

use super::session::{Identity, Session};
use super::{Incoming, Outgoing};
use crate::key::JoinKey;
use crate::messages::{
    Answer, Beat, BeatReply, Exchange, MOST_BYTES, WeightsReply, WeightsRequest,
};

/// Largest number of deliveries under way at once.
const WINDOW: usize = 8;

/// How often the hub is told that this host is alive.
const BEAT: Duration = Duration::from_millis(500);

/// Number of latest beats; the fastest is reported as the distance to the hub.
const DISTANCES: usize = 8;

/// What the link needs.
pub(super) struct Setup {
    pub(super) folder: RunFolder,
    pub(super) key: JoinKey,
    pub(super) identity: Identity,
    pub(super) stop: Stop,
}

/// The link.
struct Link {
    session: Session,
    news: SyncSender<Incoming>,
    bell: Rc<Ringer>,
    window: Arc<Semaphore>,
    /// Tells this host's supervisor how many actors to run.
    wanted: ActorsWanted,
    alive: RefCell<BTreeSet<String>>,
    /// Policy versions that the desk has been given. The lock also makes fetches take turns.
    versions: Mutex<Vec<u64>>,
}

/// Works until a stop is requested or the desk has ended; in any other case tells the desk why it ends.
pub(super) fn run(setup: Setup, orders: Receiver<Outgoing>, news: SyncSender<Incoming>) {
    if let Err(error) = work(setup, orders, news.clone()) {
        // A desk that has ended no longer needs it.
        news.send(Incoming::Failed(error)).ok();
    }
}

fn work(setup: Setup, orders: Receiver<Outgoing>, news: SyncSender<Incoming>) -> Result<()> {
    let Setup { folder, key, identity, stop } = setup;
    let bus = Bus::open(&BusAddress::of_run(folder.path())?, "gateway-link")?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let tasks = LocalSet::new();
    tasks.block_on(&runtime, async {
        let link = Rc::new(Link {
            session: Session::new(&folder, &key, identity)?,
            news,
            bell: bus.ringer(Role::Learner)?,
            window: Arc::new(Semaphore::new(WINDOW)),
            wanted: ActorsWanted::here(&folder),
            alive: RefCell::default(),
            versions: Mutex::default(),
        });
        let ended = tokio::select! {
            ended = link.beat(&stop) => ended,
            ended = link.follow(orders) => ended,
        };
        if ended.is_ok() {
            link.session.leave().await;
        }
        ended
    })
}

impl Link {
    fn tell(&self, incoming: Incoming) -> Result<()> {
        self.news.send(incoming).ok().context("the desk has ended")?;
        Ok(self.bell.ring()?)
    }

    /// Tells the hub every half second that this host is alive.
    async fn beat(&self, stop: &Stop) -> Result<()> {
        let session = self.session.number;
        let mut distances = VecDeque::new();
        while !stop.is_requested() {
            let fastest = distances.iter().copied().min();
            let distance_ms = fastest.map(|fastest: Duration| 1000.0 * fastest.as_secs_f64());
            let alive = || self.alive.borrow().iter().cloned().collect();
            let beat = || Beat { session, actors: alive(), distance_ms };
            let begun = Instant::now();
            let told = self.session.call(0, |mut hub| {
                let beat = beat();
                async move { hub.beat(beat).await }
            });
            let BeatReply { finished, actors } = told.await?;
            if finished {
                self.tell(Incoming::Over)?;
            }
            if self.session.wants(actors)
                && let Err(error) = self.wanted.want(actors)
            {
                tracing::warn!("{error}");
            }
            distances.push_back(begun.elapsed());
            if distances.len() > DISTANCES {
                distances.pop_front();
            }
            tokio::time::sleep(BEAT).await;
        }
        Ok(())
    }

    /// Carries out the desk's orders until it has ended.
    async fn follow(self: &Rc<Self>, mut orders: Receiver<Outgoing>) -> Result<()> {
        while let Some(order) = orders.recv().await {
            match order {
                Outgoing::Alive(actors) => *self.alive.borrow_mut() = actors.into_iter().collect(),
                Outgoing::Deliver { actor, trajectories } => {
                    // The desk waits while `WINDOW` deliveries are under way.
                    let place = Arc::clone(&self.window).acquire_owned().await?;
                    self.spawn(async move |link| {
                        let done = link.deliver(actor, trajectories).await;
                        drop(place);
                        done
                    });
                }
                Outgoing::Ask { number, request, trajectories } => {
                    let session = self.session.number;
                    let actor = request.actor.clone();
                    self.alive.borrow_mut().insert(actor.clone());
                    let request = Some(request.encode_to_vec().into());
                    let question = Exchange { session, trajectories, number, request };
                    self.spawn(async move |link| link.ask(actor, question).await);
                }
            }
        }
        Ok(())
    }

    fn spawn<F>(self: &Rc<Self>, task: F)
    where
        F: AsyncFnOnce(Rc<Link>) -> Result<()> + 'static,
    {
        let link = Rc::clone(self);
        tokio::task::spawn_local(async move {
            if let Err(error) = task(Rc::clone(&link)).await {
                // A desk that has ended no longer needs it.
                link.tell(Incoming::Failed(error)).ok();
            }
        });
    }

    async fn deliver(&self, actor: String, trajectories: Vec<Bytes>) -> Result<()> {
        let session = self.session.number;
        self.exchange(&Exchange { session, trajectories, ..Exchange::default() }).await?;
        self.tell(Incoming::Delivered { actor })
    }

    /// Repeats a lease request until there is a reply, and passes on the weights for the leases before the reply.
    /// Stops when the actor is gone.
    async fn ask(&self, actor: String, mut question: Exchange) -> Result<()> {
        while self.alive.borrow().contains(&actor) {
            let Answer { reply } = self.exchange(&question).await?;
            if let Some(reply) = reply {
                return self.answer(actor, question.number, reply).await;
            }
            question.trajectories.clear();
        }
        Ok(())
    }

    async fn answer(&self, actor: String, number: u64, reply: LeaseReply) -> Result<()> {
        if let Some(lease) = reply.leases.first() {
            self.fetch(lease.policy_version).await?;
        }
        self.tell(Incoming::Answered { actor, number, reply })
    }

    async fn exchange(&self, exchange: &Exchange) -> Result<Answer> {
        // As many may be under way, and each gets its share of the link.
        let bytes = WINDOW * exchange.trajectories.iter().map(Bytes::len).sum::<usize>();
        let call = self.session.call(bytes, |mut hub| {
            let exchange = exchange.clone();
            async move { hub.exchange(exchange).await }
        });
        call.await
    }

    /// Has the desk publish a version of the policy, unless it already has.
    async fn fetch(&self, version: u64) -> Result<()> {
        let mut versions = self.versions.lock().await;
        if versions.contains(&version) {
            return Ok(());
        }
        let session = self.session.number;
        // Their size is not known before they are here.
        let call = self.session.call(MOST_BYTES, |mut hub| async move {
            hub.weights(WeightsRequest { session, version }).await
        });
        // The hub does not have a version that has been replaced; the actor hands such a lease back.
        let WeightsReply { weights: Some(weights) } = call.await? else { return Ok(()) };
        self.tell(Incoming::Weights(weights))?;
        versions.push(version);
        if versions.len() > POLICY_VERSIONS {
            versions.remove(0);
        }
        Ok(())
    }
}
