//! `goalward-gateway serve`: the hub, beside the learner.
//!
//! Calls are answered by one thread; what touches the bus is done by a thread for each host, because the
//! bus may have to be waited for. Nothing that comes from a host is published before it is checked, and
//! what is wrong with it costs the host its place, nobody else anything.

mod calls;
mod guest;
mod newest;
mod stand_in;

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use run::folder::RunFolder;
use run::process::Stop;
use tokio::net::TcpListener;
use tokio::sync::watch;
use tokio_stream::StreamExt;
use tokio_stream::wrappers::TcpListenerStream;
use tonic::transport::Server;

use crate::calls::gateway_server::GatewayServer;
use crate::key::HubKey;
use crate::messages::MOST_BYTES;
use crate::{KEEPALIVE, KEEPALIVE_PATIENCE};
use calls::Calls;
use guest::{Guest, GuestSetup};
use newest::Newest;

/// How often it is looked whether the hub is to stop.
const TICK: Duration = Duration::from_millis(50);

/// How long hosts are told of the end of the run.
const FAREWELL: Duration = Duration::from_millis(1500);

/// How long a TLS handshake may take.
const HANDSHAKE: Duration = Duration::from_secs(5);

/// Calls of one connection that are under way at once.
const CALLS_AT_ONCE: usize = 256;

/// What a hub serves.
#[derive(Clone, Debug)]
pub struct Setup {
    /// The run.
    pub folder: RunFolder,
    /// Where hosts find it.
    pub listen: SocketAddr,
    /// What this machine's actor makes of the golden episodes.
    pub golden: String,
}

/// The hub's memory of its hosts.
struct Hub {
    setup: GuestSetup,
    configuration: String,
    golden: String,
    guests: Mutex<BTreeMap<u64, Guest>>,
    /// Joinings that broke the rules, and how.
    expelled: Mutex<BTreeMap<u64, String>>,
    weights: watch::Receiver<Newest>,
    is_ending: AtomicBool,
}

impl Hub {
    fn guests(&self) -> MutexGuard<'_, BTreeMap<u64, Guest>> {
        self.guests.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn expelled(&self) -> MutexGuard<'_, BTreeMap<u64, String>> {
        self.expelled.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether the run is over for its hosts.
    fn is_finished(&self) -> bool {
        self.is_ending.load(Ordering::Relaxed) && self.setup.folder.summary_file().exists()
    }
}

/// Whether a host may call itself, or its actor, so.
fn is_name(name: &str, most_bytes: usize) -> bool {
    let fits = |letter: char| letter.is_ascii_alphanumeric() || "-_.".contains(letter);
    (1..=most_bytes).contains(&name.len()) && name.chars().all(fits)
}

/// Serves a run's hosts until it is to stop.
///
/// # Errors
/// When the address cannot be listened at, or the bus fails.
pub fn serve(setup: &Setup, key: &HubKey, stop: &Stop) -> Result<()> {
    let folder = &setup.folder;
    let config = folder.config()?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        let listen = setup.listen;
        let listener =
            TcpListener::bind(listen).await.with_context(|| format!("listening at {listen}"))?;
        tracing::info!("hosts join at {}", listener.local_addr()?);
        let hub = Arc::new(Hub {
            setup: GuestSetup {
                folder: folder.clone(),
                spec: config.task.spec(),
                run_seed: config.seed,
            },
            configuration: config.to_text(),
            golden: setup.golden.clone(),
            guests: Mutex::default(),
            expelled: Mutex::default(),
            weights: newest::watch(folder, stop)?,
            is_ending: AtomicBool::new(false),
        });
        let calls = GatewayServer::new(Calls::of(Arc::clone(&hub)))
            .max_decoding_message_size(MOST_BYTES)
            .max_encoding_message_size(MOST_BYTES);
        // Small answers leave at once.
        let connections = TcpListenerStream::new(listener).map(|connection| {
            connection.inspect(|stream| {
                stream.set_nodelay(true).ok();
            })
        });
        Server::builder()
            .tls_config(key.tls().timeout(HANDSHAKE))
            .context("the keys of the run")?
            .http2_keepalive_interval(Some(KEEPALIVE))
            .http2_keepalive_timeout(Some(KEEPALIVE_PATIENCE))
            .concurrency_limit_per_connection(CALLS_AT_ONCE)
            .add_service(calls)
            .serve_with_incoming_shutdown(connections, ended(&hub, stop))
            .await
            .context("serving hosts")?;
        ensure!(stop.is_requested(), "the bus of the run cannot be read any more");
        Ok(())
    })
}

/// Waits until the hub is to stop or has lost the bus, and then until its hosts have heard of it.
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
