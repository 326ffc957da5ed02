//! A session with the hub: calls are repeated until they are answered.

use std::cell::{Cell, RefCell};
use std::future::Future;
use std::hash::{BuildHasher, RandomState};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow};
use protocol::build;
use run::folder::RunFolder;
use run::hosts::{Host, Hosts};
use tonic::transport::{Channel, Endpoint};
use tonic::{Code, Response, Status};

use crate::calls::gateway_client::GatewayClient;
use crate::key::JoinKey;
use crate::messages::{ConfigurationRequest, Goodbye, Hello, MOST_BYTES, PROTOCOL};
use crate::{KEEPALIVE, KEEPALIVE_PATIENCE, WINDOWS};

/// How long connecting to the hub may take.
const CONNECT_PATIENCE: Duration = Duration::from_secs(3);

/// How long an answer may take, besides the time that the link needs for large messages. The hub holds lease requests
/// for two seconds.
const CALL_PATIENCE: Duration = Duration::from_secs(5);

/// Slowest link that messages are given time for, bytes per second: 1 Mbit/s.
const SLOWEST_LINK: f64 = 125e3;

/// Number of times that a call goes without an answer before the user is told.
const LATE: u32 = 3;

/// How long a host that leaves waits for the hub to note it.
const GOODBYE_PATIENCE: Duration = Duration::from_secs(1);

/// The first and the longest pause before a call is repeated.
const PAUSES: [Duration; 2] = [Duration::from_millis(50), Duration::from_secs(1)];

/// How long to go on trying a hub that does not answer.
const HUB_PATIENCE: Duration = Duration::from_secs(60);

/// Status codes that are final, because repeating the call would not help. A message that is too long is `OutOfRange`.
const FINAL: [Code; 5] = [
    Code::FailedPrecondition,
    Code::InvalidArgument,
    Code::OutOfRange,
    Code::PermissionDenied,
    Code::Unimplemented,
];

/// What a host says about itself.
#[derive(Clone, Debug)]
pub struct Identity {
    /// The name that the host asks for.
    pub host: String,
    /// The host's output of `goalward-actor golden`.
    pub golden: String,
    /// Whether it may join with a build other than the hub's.
    pub other_build: bool,
    /// Number of actors that it is to run at first.
    pub actors: u64,
}

/// A session with the hub.
pub(super) struct Session {
    pub(super) number: u64,
    /// This host's folder for the run.
    folder: RunFolder,
    address: String,
    identity: Identity,
    client: GatewayClient<Channel>,
    /// When the hub last answered.
    heard: Cell<Instant>,
    host: RefCell<Option<String>>,
    /// Number of actors that this host is to run.
    actors: Cell<u64>,
    /// Number of hellos so far. It makes only one of several calls say hello when the hub does not know the session.
    hellos: tokio::sync::Mutex<u64>,
    /// Whether the user was told that calls go without an answer.
    has_told: Cell<bool>,
}

/// Makes a client of the hub, which connects when it is first used.
///
/// # Errors
/// When the key has no valid address, or its certificates are invalid.
pub fn connect(key: &JoinKey) -> Result<GatewayClient<Channel>> {
    let endpoint = Endpoint::from_shared(format!("https://{}", key.address))
        .with_context(|| format!("expected an address HOST:PORT, found {:?}", key.address))?;
    let channel = endpoint
        .tls_config(key.tls())
        .context("the keys of the run")?
        .connect_timeout(CONNECT_PATIENCE)
        .tcp_nodelay(true)
        .initial_stream_window_size(WINDOWS[0])
        .initial_connection_window_size(WINDOWS[1])
        .http2_keep_alive_interval(KEEPALIVE)
        .keep_alive_timeout(KEEPALIVE_PATIENCE)
        .keep_alive_while_idle(true)
        .connect_lazy();
    let client = GatewayClient::new(channel);
    // Sending has no limit: the hub refuses messages that are too long, whereas an error here would look like a broken
    // link.
    Ok(client.max_decoding_message_size(MOST_BYTES))
}

/// Requests the configuration of the run. There is one attempt, so that a wrong address or key is reported at once.
///
/// # Errors
/// When the hub cannot be reached or refuses.
pub(super) async fn configuration(key: &JoinKey) -> Result<String> {
    let mut client = connect(key)?;
    let asked = client.configuration(ConfigurationRequest { protocol: PROTOCOL });
    let answer = tokio::time::timeout(CALL_PATIENCE, asked).await;
    let answer = answer.unwrap_or_else(|_| Err(late(CALL_PATIENCE)));
    let answer = answer.map_err(|status| anyhow!(words(&status)));
    let answer = answer.with_context(|| format!("the hub at {}", key.address))?;
    Ok(answer.into_inner().text)
}

impl Session {
    pub(super) fn new(folder: &RunFolder, key: &JoinKey, identity: Identity) -> Result<Session> {
        Ok(Session {
            number: RandomState::new().hash_one(std::process::id()),
            folder: folder.clone(),
            address: key.address.clone(),
            actors: Cell::new(identity.actors),
            identity,
            client: connect(key)?,
            heard: Cell::new(Instant::now()),
            host: RefCell::new(None),
            hellos: tokio::sync::Mutex::new(0),
            has_told: Cell::new(false),
        })
    }

    /// Notes how many actors this host is to run; returns whether the number has changed.
    pub(super) fn wants(&self, actors: u64) -> bool {
        self.actors.replace(actors) != actors
    }

    /// Repeats a call until the hub answers it. The link may have to carry `bytes` before the answer.
    ///
    /// # Errors
    /// When the hub refuses this host, or has not answered for [`HUB_PATIENCE`].
    pub(super) async fn call<T, F>(
        &self,
        bytes: usize,
        make: impl Fn(GatewayClient<Channel>) -> F,
    ) -> Result<T>
    where
        F: Future<Output = Result<Response<T>, Status>>,
    {
        let (mut pause, patience, mut late) = (PAUSES[0], patience(bytes), 0);
        loop {
            let hellos = *self.hellos.lock().await;
            match self.once(patience, &make).await {
                Ok(answer) => return Ok(answer),
                Err(status) if status.code() == Code::Unauthenticated => {
                    self.hello_after(hellos).await?;
                }
                Err(status) => {
                    late += u32::from(status.code() == Code::DeadlineExceeded);
                    self.tell_if_late(late, patience);
                    self.bear(&status)?;
                }
            }
            tokio::time::sleep(pause).await;
            pause = (pause * 2).min(PAUSES[1]);
        }
    }

    async fn once<T, F>(
        &self,
        patience: Duration,
        make: impl Fn(GatewayClient<Channel>) -> F,
    ) -> Result<T, Status>
    where
        F: Future<Output = Result<Response<T>, Status>>,
    {
        let answer = tokio::time::timeout(patience, make(self.client.clone())).await;
        let answer = answer.unwrap_or_else(|_| Err(late(patience)))?;
        self.heard.set(Instant::now());
        Ok(answer.into_inner())
    }

    /// Tells the user once that a call has gone without an answer too often, although others may be answered.
    fn tell_if_late(&self, late: u32, patience: Duration) {
        if late >= LATE && !self.has_told.replace(true) {
            tracing::warn!(
                "the hub at {} has not answered a message {late} times within {patience:?}, and gets it \
                 again: the link is slow, or the hub is busy",
                self.address
            );
        }
    }

    /// Tells the hub that this host leaves, so that its places are free at once. Otherwise the hub finds out by itself
    /// within seconds.
    pub(super) async fn leave(&self) {
        let mut hub = self.client.clone();
        let goodbye = hub.goodbye(Goodbye { session: self.number });
        let answer = tokio::time::timeout(GOODBYE_PATIENCE, goodbye).await;
        if let Err(status) = answer.unwrap_or_else(|_| Err(late(GOODBYE_PATIENCE))) {
            tracing::debug!("the hub at {}: {}", self.address, words(&status));
        }
    }

    /// Returns the name to ask for: the one that this host got when it joined, if it did.
    fn name(&self) -> String {
        self.host.borrow().as_ref().unwrap_or(&self.identity.host).clone()
    }

    /// Says hello, unless another call has done so since the count was `hellos`.
    async fn hello_after(&self, hellos: u64) -> Result<()> {
        let mut said = self.hellos.lock().await;
        if *said > hellos {
            return Ok(());
        }
        let hello = || Hello {
            protocol: PROTOCOL,
            session: self.number,
            host: self.name(),
            build: build::version().to_owned(),
            golden: self.identity.golden.clone(),
            other_build: self.identity.other_build,
            actors: self.actors.get(),
        };
        let say = |mut client: GatewayClient<Channel>| async move { client.hello(hello()).await };
        match self.once(CALL_PATIENCE, say).await {
            Ok(welcome) => {
                *said += 1;
                let known = self.host.replace(Some(welcome.host.clone()));
                let verb = if known.is_none() { "joined" } else { "back in" };
                tracing::info!("{verb} the run at {} as {}", self.address, welcome.host);
                self.keep_name(welcome.host);
                Ok(())
            }
            Err(status) => self.bear(&status),
        }
    }

    /// Keeps the name that this host got, which its supervisor tells the user.
    fn keep_name(&self, name: String) {
        let (build, actors) = (build::version().to_owned(), self.actors.get());
        let present = vec![Host { name, build, actors, distance_ms: None }];
        let hosts = Hosts { present, ..Hosts::default() };
        if let Err(error) = hosts.write(&self.folder) {
            tracing::warn!("the name of this host could not be kept: {error}");
        }
    }

    /// Decides about a failed call: returns an error if it is not to be repeated.
    fn bear(&self, status: &Status) -> Result<()> {
        if FINAL.contains(&status.code()) {
            return Err(anyhow!(
                "the hub at {} refuses this host: {}",
                self.address,
                words(status)
            ));
        }
        tracing::debug!("the hub at {}: {}", self.address, words(status));
        if self.heard.get().elapsed() < HUB_PATIENCE {
            return Ok(());
        }
        let seconds = HUB_PATIENCE.as_secs();
        Err(anyhow!(
            "nothing heard of the hub at {} for {seconds} s: {}",
            self.address,
            words(status)
        ))
    }
}

/// Returns how long an answer may take if the link has to carry `bytes` before.
fn patience(bytes: usize) -> Duration {
    CALL_PATIENCE + Duration::from_secs_f64(bytes as f64 / SLOWEST_LINK)
}

fn late(patience: Duration) -> Status {
    Status::deadline_exceeded(format!("no answer within {patience:?}"))
}

/// Returns a status message with its causes, in one line.
fn words(status: &Status) -> String {
    let mut said = status.message().to_owned();
    let mut cause = std::error::Error::source(status);
    while let Some(error) = cause {
        let words = error.to_string();
        if !said.contains(&words) {
            said += &format!(": {words}");
        }
        cause = error.source();
    }
    said
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::key;

    #[test]
    fn a_large_message_may_take_as_long_as_a_slow_link_needs() {
        assert_eq!(patience(0), CALL_PATIENCE);
        assert_eq!(patience(1_250_000), CALL_PATIENCE + Duration::from_secs(10));
    }

    fn block_on<T>(work: impl Future<Output = T>) -> T {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        runtime.block_on(work)
    }

    /// Returns a session with a hub that is not there, inside a Tokio runtime.
    fn session() -> Session {
        let directory = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(directory.path());
        key::of_run(&folder, "127.0.0.1:9").unwrap();
        let key = JoinKey::of_file(&folder.join_file()).unwrap();
        let (host, golden) = ("node-7".to_owned(), String::new());
        let identity = Identity { host, golden, other_build: false, actors: 1 };
        Session::new(&folder, &key, identity).unwrap()
    }

    #[test]
    fn the_user_is_told_when_a_call_is_late_again_and_again() {
        block_on(async {
            let (session, tries) = (session(), Cell::new(0));
            let answer = |_| {
                let earlier = tries.replace(tries.get() + 1);
                let is_late = earlier < LATE;
                let told = session.has_told.get();
                async move { if is_late { Err(late(CALL_PATIENCE)) } else { Ok(Response::new(told)) } }
            };
            assert!(session.call(0, answer).await.unwrap());
            assert_eq!(tries.get(), LATE + 1);
        });
    }

    #[test]
    fn a_message_that_is_too_long_is_not_sent_again() {
        block_on(async {
            let session = session();
            session.bear(&Status::unavailable("for a moment")).unwrap();
            let refused = session.bear(&Status::out_of_range("too long")).unwrap_err();
            assert_eq!(refused.to_string(), "the hub at 127.0.0.1:9 refuses this host: too long");
        });
    }
}
