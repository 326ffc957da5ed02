//! A session with the hub: calls are repeated until they are answered.

use std::cell::{Cell, RefCell};
use std::future::Future;
use std::hash::{BuildHasher, RandomState};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow};
use protocol::build;
use tonic::transport::{Channel, Endpoint};
use tonic::{Code, Response, Status};

use crate::calls::gateway_client::GatewayClient;
use crate::key::JoinKey;
use crate::messages::{ConfigurationRequest, Hello, MOST_BYTES, PROTOCOL};
use crate::{KEEPALIVE, KEEPALIVE_PATIENCE, WINDOWS};

/// How long connecting to the hub may take.
const CONNECT_PATIENCE: Duration = Duration::from_secs(3);

/// How long an answer may take; the hub holds lease requests for two seconds.
const CALL_PATIENCE: Duration = Duration::from_secs(5);

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
    let answer = answer.unwrap_or_else(|_| Err(late())).map_err(|status| anyhow!(words(&status)));
    let answer = answer.with_context(|| format!("the hub at {}", key.address))?;
    Ok(answer.into_inner().text)
}

impl Session {
    pub(super) fn new(key: &JoinKey, identity: Identity) -> Result<Session> {
        Ok(Session {
            number: RandomState::new().hash_one(std::process::id()),
            address: key.address.clone(),
            actors: Cell::new(identity.actors),
            identity,
            client: connect(key)?,
            heard: Cell::new(Instant::now()),
            host: RefCell::new(None),
            hellos: tokio::sync::Mutex::new(0),
        })
    }

    /// Notes how many actors this host is to run; returns whether the number has changed.
    pub(super) fn wants(&self, actors: u64) -> bool {
        self.actors.replace(actors) != actors
    }

    /// Repeats a call until the hub answers it.
    ///
    /// # Errors
    /// When the hub refuses this host, or has not answered for [`HUB_PATIENCE`].
    pub(super) async fn call<T, F>(&self, make: impl Fn(GatewayClient<Channel>) -> F) -> Result<T>
    where
        F: Future<Output = Result<Response<T>, Status>>,
    {
        let mut pause = PAUSES[0];
        loop {
            let hellos = *self.hellos.lock().await;
            match self.once(&make).await {
                Ok(answer) => return Ok(answer),
                Err(status) if status.code() == Code::Unauthenticated => {
                    self.hello_after(hellos).await?;
                }
                Err(status) => self.bear(&status)?,
            }
            tokio::time::sleep(pause).await;
            pause = (pause * 2).min(PAUSES[1]);
        }
    }

    async fn once<T, F>(&self, make: impl Fn(GatewayClient<Channel>) -> F) -> Result<T, Status>
    where
        F: Future<Output = Result<Response<T>, Status>>,
    {
        let answer = tokio::time::timeout(CALL_PATIENCE, make(self.client.clone())).await;
        let answer = answer.unwrap_or_else(|_| Err(late()))?;
        self.heard.set(Instant::now());
        Ok(answer.into_inner())
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
            host: self.identity.host.clone(),
            build: build::version().to_owned(),
            golden: self.identity.golden.clone(),
            other_build: self.identity.other_build,
            actors: self.actors.get(),
        };
        let answer = self.once(|mut client| async move { client.hello(hello()).await }).await;
        match answer {
            Ok(welcome) => {
                *said += 1;
                let known = self.host.replace(Some(welcome.host.clone()));
                let verb = if known.is_none() { "joined" } else { "back in" };
                tracing::info!("{verb} the run at {} as {}", self.address, welcome.host);
                Ok(())
            }
            Err(status) => self.bear(&status),
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

fn late() -> Status {
    Status::deadline_exceeded(format!("no answer within {CALL_PATIENCE:?}"))
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
    use run::folder::RunFolder;

    use super::*;
    use crate::key;

    #[test]
    fn a_message_that_is_too_long_is_not_sent_again() {
        let directory = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(directory.path());
        key::of_run(&folder, "127.0.0.1:9").unwrap();
        let key = JoinKey::of_file(&key::join_file(&folder)).unwrap();
        let (host, golden) = ("node-7".to_owned(), String::new());
        let identity = Identity { host, golden, other_build: false, actors: 1 };
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        let _entered = runtime.enter();
        let session = Session::new(&key, identity).unwrap();
        session.bear(&Status::unavailable("for a moment")).unwrap();
        let refused = session.bear(&Status::out_of_range("too long")).unwrap_err();
        assert_eq!(refused.to_string(), "the hub at 127.0.0.1:9 refuses this host: too long");
    }
}
