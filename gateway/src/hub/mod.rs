//! `goalward-gateway serve`: the hub, beside the learner.
//!
//! One thread answers calls. For each host a thread does what touches the bus, because it may have to wait for the
//! bus. Nothing from a host is published before it is checked. A host that sends something invalid is expelled, and
//! nobody else is affected.

mod audit;
mod calls;
mod connections;
mod guest;
mod newest;
mod stand_in;

use std::collections::{BTreeMap, VecDeque};
use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use bus::{Bus, BusAddress, Sleeper};
use protocol::MAX_ACTORS;
use protocol::dropped::Dropped;
use run::folder::RunFolder;
use run::hosts::{Expelled, Hosts};
use run::process::Stop;
use tokio::net::TcpListener;
use tokio::sync::{mpsc, watch};
use tonic::transport::Server;

use crate::calls::gateway_server::GatewayServer;
use crate::key::HubKey;
use crate::messages::MOST_BYTES;
use crate::{KEEPALIVE, KEEPALIVE_PATIENCE, WINDOWS};
pub use audit::Audit;
use audit::Auditor;
use calls::Calls;
use guest::{Guest, GuestSetup};
use newest::Newest;

/// How often to check whether the hub is to stop.
const TICK: Duration = Duration::from_millis(50);

/// How long to go on telling hosts that the run is over.
const FAREWELL: Duration = Duration::from_millis(1500);

/// How long a TLS handshake may take.
const HANDSHAKE: Duration = Duration::from_secs(5);

/// Largest number of connections at once: one of every host, and as many of hosts that reconnect.
const CONNECTIONS: usize = 2 * MAX_ACTORS;

/// Largest number of concurrent calls of one connection: an open request of every actor, and some more of their host.
const CALLS_AT_ONCE: usize = MAX_ACTORS + 16;

/// How often the list of hosts in the run's folder is updated.
const KEEP_HOSTS: Duration = Duration::from_millis(500);

/// Number of host threads that may wait to be woken.
const TO_BE_WOKEN: usize = 1024;

/// Parameters of a hub.
#[derive(Clone, Debug)]
pub struct Setup {
    /// The run's folder.
    pub folder: RunFolder,
    /// The address to listen at.
    pub listen: SocketAddr,
    /// The output of `goalward-actor golden` on this machine.
    pub golden: String,
    /// The audit of episodes from hosts, if there is one.
    pub audit: Option<Audit>,
}

/// The hub's state.
struct Hub {
    setup: GuestSetup,
    configuration: String,
    golden: String,
    guests: Mutex<BTreeMap<u64, Guest>>,
    /// Expelled hosts, the oldest first, with their sessions; those of an earlier gateway of the run have none.
    expelled: Mutex<VecDeque<(Option<u64>, Expelled)>>,
    /// Hosts that were refused.
    refused: Mutex<Dropped>,
    weights: watch::Receiver<Newest>,
    auditor: Option<Auditor>,
    is_ending: AtomicBool,
}

impl Hub {
    fn guests(&self) -> MutexGuard<'_, BTreeMap<u64, Guest>> {
        self.guests.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn expelled(&self) -> MutexGuard<'_, VecDeque<(Option<u64>, Expelled)>> {
        self.expelled.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Notes that a host was refused. Whoever has the key can cause any number of refusals.
    fn note_refusal(&self, why: &str) {
        self.refused.lock().unwrap_or_else(PoisonError::into_inner).note(why);
    }

    /// Returns the reason why a session was expelled, if it was.
    fn offence(&self, session: u64) -> Option<String> {
        let expelled = self.expelled();
        let found = expelled.iter().find(|(known, _)| *known == Some(session));
        found.map(|(_, who)| who.why.clone())
    }

    /// Returns the reason why a host of this name was expelled, if one was.
    fn offence_of(&self, host: &str) -> Option<String> {
        let expelled = self.expelled();
        expelled.iter().find(|(_, who)| who.name == host).map(|(_, who)| who.why.clone())
    }

    /// Returns the hosts that take part and those that were expelled.
    fn hosts(&self) -> Hosts {
        let guests = self.guests();
        let present = guests.values().filter(|guest| guest.is_there());
        let present = present.map(|guest| guest.about.clone()).collect();
        let expelled = self.expelled().iter().map(|(_, who)| who.clone()).collect();
        let unaudited = self.auditor.as_ref().and_then(Auditor::trouble);
        Hosts { present, expelled, unaudited }
    }

    /// Returns whether the run is over for its hosts.
    fn is_finished(&self) -> bool {
        self.is_ending.load(Ordering::Relaxed) && self.setup.folder.summary_file().exists()
    }
}

/// Returns whether a name is allowed for a host or an actor.
fn is_name(name: &str, most_bytes: usize) -> bool {
    let fits = |letter: char| letter.is_ascii_alphanumeric() || "-_.".contains(letter);
    (1..=most_bytes).contains(&name.len()) && name.chars().all(fits)
}

/// Serves a run's hosts until a stop is requested.
///
/// # Errors
/// When it is impossible to listen at the address, or when the bus fails.
pub fn serve(setup: &Setup, key: &HubKey, stop: &Stop) -> Result<()> {
    let folder = &setup.folder;
    let config = folder.config()?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        let listen = setup.listen;
        let listener =
            TcpListener::bind(listen).await.with_context(|| format!("listening at {listen}"))?;
        tracing::info!("hosts join at {}", listener.local_addr()?);
        let weights = newest::watch(folder, stop)?;
        let spec = config.task.spec();
        let auditor = setup.audit.as_ref();
        let auditor = auditor.map(|audit| Auditor::start(audit, folder, spec, weights.clone()));
        let (wake, sleepers) = mpsc::channel(TO_BE_WOKEN);
        // The list of an earlier gateway is there if that was killed. A run that starts removes it.
        let expelled = Hosts::of_run(folder).expelled.into_iter();
        let hub = Arc::new(Hub {
            setup: GuestSetup {
                folder: folder.clone(),
                task: config.task.name.clone(),
                spec,
                run_seed: config.seed,
                wake,
                threads: Arc::default(),
            },
            configuration: config.to_text(),
            golden: setup.golden.clone(),
            guests: Mutex::default(),
            expelled: Mutex::new(expelled.map(|who| (None, who)).collect()),
            refused: Mutex::new(Dropped::new("requests of hosts to join")),
            weights,
            auditor,
            is_ending: AtomicBool::new(false),
        });
        tokio::select! {
            served = answer_calls(&hub, listener, key, stop) => served?,
            woken = wake_threads(folder, sleepers) => woken?,
            () = keep_hosts(&hub) => {}
        }
        ensure!(stop.is_requested(), "the bus of the run can no longer be read");
        Hosts::clear(folder);
        Ok(())
    })
}

async fn answer_calls(
    hub: &Arc<Hub>,
    listener: TcpListener,
    key: &HubKey,
    stop: &Stop,
) -> Result<()> {
    let calls = GatewayServer::new(Calls::of(Arc::clone(hub)))
        .max_decoding_message_size(MOST_BYTES)
        .max_encoding_message_size(MOST_BYTES);
    Server::builder()
        .tls_config(key.tls().timeout(HANDSHAKE))
        .context("the keys of the run")?
        .http2_keepalive_interval(Some(KEEPALIVE))
        .http2_keepalive_timeout(Some(KEEPALIVE_PATIENCE))
        .initial_stream_window_size(WINDOWS[0])
        .initial_connection_window_size(WINDOWS[1])
        .concurrency_limit_per_connection(CALLS_AT_ONCE)
        .add_service(calls)
        .serve_with_incoming_shutdown(
            connections::accepted(listener, CONNECTIONS),
            ended(hub, stop),
        )
        .await
        .context("serving hosts")
}

/// Wakes the threads of hosts. This is a task of its own because handlers of calls have to be `Send`, and ports of the
/// bus are not.
async fn wake_threads(folder: &RunFolder, mut sleepers: mpsc::Receiver<Sleeper>) -> Result<()> {
    let bus = Bus::open(&BusAddress::of_run(folder.path())?, "gateway-calls")?;
    while let Some(sleeper) = sleepers.recv().await {
        bus.wake(sleeper)?;
    }
    Ok(())
}

/// Keeps the list of hosts in the run's folder up to date.
async fn keep_hosts(hub: &Hub) {
    let mut kept = None;
    loop {
        let hosts = hub.hosts();
        if kept.as_ref() != Some(&hosts) {
            match hosts.write(&hub.setup.folder) {
                Ok(()) => kept = Some(hosts),
                Err(error) => tracing::debug!("hosts could not be kept: {error}"),
            }
        }
        tokio::time::sleep(KEEP_HOSTS).await;
    }
}

/// Waits until a stop is requested or the bus is lost, and then until the hosts have been told.
async fn ended(hub: &Hub, stop: &Stop) {
    let has_bus = || hub.weights.has_changed().is_ok();
    while !stop.is_requested() && has_bus() {
        tokio::time::sleep(TICK).await;
    }
    hub.is_ending.store(true, Ordering::Relaxed);
    if !hub.guests().is_empty() {
        tokio::time::sleep(FAREWELL).await;
    }
    hub.guests().clear();
}
