//! The hub's replies to the calls of hosts.

use std::sync::Arc;
use std::time::Duration;

use bus::BusAddress;
use protocol::dropped::shortened;
use protocol::{MAX_ACTORS, build};
use run::actors_wanted::ActorsWanted;
use run::hosts::{Expelled, NAME_CHARS};
use tokio::sync::oneshot;
use tonic::{Request, Response, Status};

use super::audit::{Trial, Verdict};
use super::guest::{BUILD_CHARS, Guest, Opened, Order, places};
use super::stand_in::Refusal;
use super::{Hub, is_name};
use crate::calls::gateway_server::Gateway;
use crate::messages::{
    Answer, Beat, BeatReply, Configuration, ConfigurationRequest, Exchange, Farewell, Goodbye,
    Hello, PROTOCOL, WeightsReply, WeightsRequest, Welcome,
};

/// How long to wait for weights that the learner has not published yet.
const WEIGHTS_PATIENCE: Duration = Duration::from_millis(500);

/// How long a host's thread may take to open the bus. A host waits a little longer for its welcome, and asks again.
const OPEN_PATIENCE: Duration = Duration::from_secs(4);

/// Largest number of threads of earlier sessions that may be ending. Each holds places on the bus.
const ENDING: usize = 8;

/// Number of expelled hosts to remember; it is bounded because whoever has the key can cause any number of them.
const EXPELLED: usize = 1024;

/// The gRPC service of the hub.
#[derive(Clone)]
pub(super) struct Calls {
    hub: Arc<Hub>,
}

impl Calls {
    pub(super) fn of(hub: Arc<Hub>) -> Calls {
        Calls { hub }
    }

    /// Gives an order to a host's thread and waits for the outcome.
    async fn done<T>(
        &self,
        session: u64,
        order: impl FnOnce(oneshot::Sender<T>) -> Order,
    ) -> Result<T, Status> {
        let (done, answer) = oneshot::channel();
        let has_room = self.hub.guests().get(&session).map(|guest| guest.order(order(done)));
        match (has_room, answer.await) {
            (_, Ok(answer)) => Ok(answer),
            (Some(false), Err(_)) => {
                Err(Status::resource_exhausted("more at once than a host may ask"))
            }
            (_, Err(_)) => Err(self.stranger(session)),
        }
    }

    /// Returns why a session is not known.
    fn stranger(&self, session: u64) -> Status {
        match self.hub.offence(session) {
            Some(why) => Status::permission_denied(why),
            None => Status::unauthenticated("the hub does not know this joining"),
        }
    }

    /// Returns the name of the host of a session.
    fn name_of(&self, session: u64) -> Result<String, Status> {
        let name = self.hub.guests().get(&session).map(|guest| guest.host().to_owned());
        name.ok_or_else(|| self.stranger(session))
    }

    /// Expels a host that broke the rules.
    fn expel(&self, session: u64, why: &str) -> Status {
        match self.name_of(session) {
            Ok(name) => self.expel_as(name, session, why),
            Err(stranger) => stranger,
        }
    }

    /// Expels a host by its name and session, even if it has left in the meantime. If another of its calls has expelled
    /// it already, the first reason stands.
    fn expel_as(&self, name: String, session: u64, why: &str) -> Status {
        self.hub.guests().retain(|other, guest| *other != session && guest.host() != name);
        if let Some(first) = self.hub.offence(session) {
            return Status::permission_denied(first);
        }
        tracing::error!("host {name} is expelled: {why}");
        let mut expelled = self.hub.expelled();
        expelled.push_back((Some(session), Expelled { name, why: why.to_owned() }));
        if expelled.len() > EXPELLED {
            expelled.pop_front();
        }
        Status::permission_denied(why)
    }

    /// Has the sampled episodes of an exchange judged, and takes out those without a verdict. Each trial runs in a task
    /// of its own, so that a host cannot stop it by ending the call.
    async fn judge(&self, exchange: &mut Exchange) -> Result<(), Status> {
        let session = exchange.session;
        let Some(auditor) = &self.hub.auditor else { return Ok(()) };
        let host = self.name_of(session)?;
        let mut passed = Vec::with_capacity(exchange.trajectories.len());
        for trajectory in std::mem::take(&mut exchange.trajectories) {
            if let Some(trial) = auditor.trial(&trajectory).await {
                let (calls, host) = (self.clone(), host.clone());
                let tried = tokio::spawn(async move { calls.passes(host, session, trial).await });
                if !tried.await.map_err(internal)?? {
                    continue;
                }
            }
            passed.push(trajectory);
        }
        exchange.trajectories = passed;
        Ok(())
    }

    /// Waits for the verdict of a trial, and expels the host if its episode differs. Returns whether the episode may be
    /// published.
    async fn passes(&self, host: String, session: u64, trial: Trial) -> Result<bool, Status> {
        match trial.verdict().await {
            Verdict::Same => Ok(true),
            Verdict::Unknown => Ok(false),
            Verdict::Differs(difference) => {
                let why = format!("its episode differs when re-simulated: {difference}");
                Err(self.expel_as(host, session, &why))
            }
        }
    }

    /// Checks what a host says about itself.
    fn check(&self, hello: &Hello) -> Result<(), Status> {
        check_protocol(hello.protocol)?;
        let refused = |what, expected: &str, found: &str| {
            let found = shortened(found, BUILD_CHARS);
            Err(Status::failed_precondition(format!("expected {what} {expected}, found {found}")))
        };
        if hello.build != build::version() && !hello.other_build {
            return refused("the build", build::version(), &hello.build);
        }
        if hello.golden != self.hub.golden {
            return refused("golden episodes of hash", &self.hub.golden, &hello.golden);
        }
        if !is_name(&hello.host, NAME_CHARS) {
            let expected = format!("of 1 to {NAME_CHARS} letters, digits, -, _ and .");
            return refused("a name", &expected, &hello.host);
        }
        Ok(())
    }

    /// Checks that the run has room for a host's actors besides those of this machine and of other hosts.
    fn check_room<'a>(
        &self,
        actors: u64,
        others: impl Iterator<Item = &'a Guest>,
    ) -> Result<(), Status> {
        let address = BusAddress::of_run(self.hub.setup.folder.path()).map_err(internal)?;
        let members = address.members().map_err(internal)?;
        let is_here = |name: &str| name.starts_with("actor") && !name.contains('@');
        let here = members.iter().filter(|member| member.lives && is_here(&member.name)).count();
        let taken = others.map(Guest::places).fold(here as u64, u64::saturating_add);
        let (wanted, room) = (places(actors), (MAX_ACTORS as u64).saturating_sub(taken));
        if wanted <= room {
            return Ok(());
        }
        let words = format!(
            "expected at most {MAX_ACTORS} actors of a run, found {taken} and {wanted} of this host; \
             there is room for {room}"
        );
        Err(Status::failed_precondition(words))
    }

    /// Admits a host and returns its name in the run. A name stays expelled, because a machine that acts otherwise does
    /// so again when it comes back.
    fn admit(&self, hello: &Hello) -> Result<(String, Opened), Status> {
        self.check(hello)?;
        let mut guests = self.hub.guests();
        // A host that comes back starts afresh: its earlier leases are granted to others.
        guests.remove(&hello.session);
        guests.retain(|_, guest| guest.is_there());
        if self.hub.setup.threads() > guests.len() + ENDING {
            return Err(Status::unavailable("the threads of earlier sessions have not ended yet"));
        }
        self.check_room(hello.actors, guests.values())?;
        let is_taken = |name: &str| guests.values().any(|guest| guest.host() == name);
        let numbered = (2..).map(|number| format!("{}-{number}", hello.host));
        let mut names = std::iter::once(hello.host.clone()).chain(numbered);
        let host = names.find(|name| !is_taken(name)).unwrap_or_default();
        if let Some(why) = self.hub.offence_of(&host) {
            let words = format!(
                "{host} has been expelled and stays so until the run is stopped and resumed; a machine \
                 that has been repaired can join with another --name ({why})"
            );
            return Err(Status::permission_denied(words));
        }
        let (guest, opened) = Guest::start(&self.hub.setup, &host, hello).map_err(internal)?;
        tracing::info!("host {host} joins, build {}", guest.about.build);
        guests.insert(hello.session, guest);
        Ok((host, opened))
    }

    /// Returns how many actors a host is to run, according to the user's latest request.
    fn actors_of(&self, session: u64) -> Option<u64> {
        let guests = self.hub.guests();
        let guest = guests.get(&session)?;
        let wanted = ActorsWanted::of_host(&self.hub.setup.folder, guest.host());
        let count = match wanted.take() {
            Ok(None) => return Some(guest.actors()),
            Ok(Some(count)) => count,
            Err(error) => {
                tracing::warn!("{error}");
                return Some(guest.actors());
            }
        };
        // Hosts that have left stay in the map until another host joins.
        let is_other = |(other, guest): &(&u64, &Guest)| **other != session && guest.is_there();
        let others = guests.iter().filter(is_other).map(|(_, guest)| guest);
        let room = self.check_room(count, others);
        match room {
            Ok(()) => guest.scale(count),
            Err(why) => tracing::warn!("host {}: {}", guest.host(), why.message()),
        }
        Some(guest.actors())
    }
}

fn internal(error: impl Into<anyhow::Error>) -> Status {
    Status::internal(format!("{:#}", error.into()))
}

/// Waits until a host's thread has opened the bus.
async fn is_open(opened: Opened) -> Result<(), Status> {
    match tokio::time::timeout(OPEN_PATIENCE, opened).await {
        Ok(Ok(opened)) => opened.map_err(internal),
        Ok(Err(gone)) => Err(internal(gone)),
        Err(_) => Err(Status::unavailable("the bus of the run does not open")),
    }
}

fn check_protocol(found: u32) -> Result<(), Status> {
    if found == PROTOCOL {
        return Ok(());
    }
    let words = format!("expected a gateway of protocol {PROTOCOL}, found one of {found}");
    Err(Status::failed_precondition(words))
}

#[tonic::async_trait]
impl Gateway for Calls {
    async fn configuration(
        &self,
        request: Request<ConfigurationRequest>,
    ) -> Result<Response<Configuration>, Status> {
        check_protocol(request.get_ref().protocol)?;
        Ok(Response::new(Configuration { text: self.hub.configuration.clone() }))
    }

    async fn hello(&self, request: Request<Hello>) -> Result<Response<Welcome>, Status> {
        let hello = request.into_inner();
        if let Some(why) = self.hub.offence(hello.session) {
            return Err(Status::permission_denied(why));
        }
        let (host, opened) = self.admit(&hello).inspect_err(|why| {
            let name = shortened(&hello.host, NAME_CHARS);
            self.hub.note_refusal(&format!("host {name:?}: {}", why.message()));
        })?;
        is_open(opened).await?;
        Ok(Response::new(Welcome { host }))
    }

    async fn beat(&self, request: Request<Beat>) -> Result<Response<BeatReply>, Status> {
        let beat = request.into_inner();
        beat.check().map_err(|why| self.expel(beat.session, &why.to_string()))?;
        let Beat { session, actors, distance_ms } = beat;
        if let Some(guest) = self.hub.guests().get_mut(&session) {
            guest.about.actors = actors.len() as u64;
            guest.about.distance_ms = distance_ms.filter(|distance| distance.is_finite());
        }
        self.done(session, |done| Order::Beat { actors, done }).await?;
        let actors = self.actors_of(session).ok_or_else(|| self.stranger(session))?;
        Ok(Response::new(BeatReply { finished: self.hub.is_finished(), actors }))
    }

    async fn exchange(&self, request: Request<Exchange>) -> Result<Response<Answer>, Status> {
        let mut exchange = request.into_inner();
        let session = exchange.session;
        exchange.check().map_err(|why| self.expel(session, &why.to_string()))?;
        self.judge(&mut exchange).await?;
        match self.done(session, |done| Order::Exchange { exchange, done }).await? {
            Ok(answer) => Ok(Response::new(answer)),
            Err(Refusal::Wrong(why)) => Err(self.expel(session, &format!("{why:#}"))),
            Err(Refusal::NoRoom(why)) => Err(Status::resource_exhausted(format!("{why:#}"))),
        }
    }

    async fn goodbye(&self, request: Request<Goodbye>) -> Result<Response<Farewell>, Status> {
        self.hub.guests().remove(&request.get_ref().session);
        Ok(Response::new(Farewell {}))
    }

    async fn weights(
        &self,
        request: Request<WeightsRequest>,
    ) -> Result<Response<WeightsReply>, Status> {
        let WeightsRequest { session, version } = request.into_inner();
        if !self.hub.guests().contains_key(&session) {
            return Err(self.stranger(session));
        }
        let mut newest = self.hub.weights.clone();
        let has = |newest: &super::Newest| newest.of_version(version).is_some();
        let found = tokio::time::timeout(WEIGHTS_PATIENCE, newest.wait_for(has)).await;
        let weights = found.ok().and_then(Result::ok).and_then(|newest| newest.of_version(version));
        Ok(Response::new(WeightsReply { weights }))
    }
}
