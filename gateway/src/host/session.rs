//! A joining: calls to the hub, made again until they are answered.

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

/// How long the hub may take to be reached.
const CONNECT_PATIENCE: Duration = Duration::from_secs(3);

/// How long an answer may take: one about leases is held for two seconds.
const CALL_PATIENCE: Duration = Duration::from_secs(5);

/// First and longest pause before a call is made again.
const PAUSES: [Duration; 2] = [Duration::from_millis(50), Duration::from_secs(1)];

/// How long a hub is tried that is not heard of.
const HUB_PATIENCE: Duration = Duration::from_secs(60);

/// Refusals that another try does not change; a message that is too long is out of range.
const FINAL: [Code; 5] = [
    Code::FailedPrecondition,
    Code::InvalidArgument,
    Code::OutOfRange,
    Code::PermissionDenied,
    Code::Unimplemented,
];

/// What a host says of itself.
#[derive(Clone, Debug)]
pub struct Identity {
    /// What people call it.
    pub host: String,
    /// What its actor makes of the golden episodes.
    pub golden: String,
    /// Whether it may join with another build than the hub's.
    pub other_build: bool,
    /// How many actors it is to have at first.
    pub actors: u64,
}

/// A joining.
pub(super) struct Session {
    pub(super) number: u64,
    address: String,
    identity: Identity,
    client: GatewayClient<Channel>,
    /// When the hub was last heard of.
    heard: Cell<Instant>,
    host: RefCell<Option<String>>,
    /// How many actors this host is to have.
    actors: Cell<u64>,
    /// Counts hellos, so that of many calls that the hub does not know one says hello.
    hellos: tokio::sync::Mutex<u64>,
}

/// A client of the hub; it connects when it is first used.
///
/// # Errors
/// When the key has no address, or is none.
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
    // What is too long to send the hub refuses: a limit here would be an error like that of a broken link.
    Ok(client.max_decoding_message_size(MOST_BYTES))
}

/// The configuration of the run; asked once, so that a wrong address or key is said at once.
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

    /// Notes how many actors this host is to have; returns whether that is news.
    pub(super) fn wants(&self, actors: u64) -> bool {
        self.actors.replace(actors) != actors
    }

    /// Makes a call again and again until the hub answers it.
    ///
    /// # Errors
    /// When the hub refuses this host, or has not been heard of for [`HUB_PATIENCE`].
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

    /// Says hello, unless another call has done so since there were so many.
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

    /// What a failed call means: some can be made again.
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

/// What a status says, with its causes, in a line.
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
