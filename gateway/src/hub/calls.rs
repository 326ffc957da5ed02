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

use super::audit::Trial;
use super::guest::{Guest, Order, places};
use super::stand_in::Refusal;
use super::{Hub, is_name};
use crate::calls::gateway_server::Gateway;
use crate::messages::{
    Answer, Beat, BeatReply, Configuration, ConfigurationRequest, Exchange, Hello, PROTOCOL,
    WeightsReply, WeightsRequest, Welcome,
};

/// How long to wait for weights that the learner has not published yet.
const WEIGHTS_PATIENCE: Duration = Duration::from_millis(500);

/// Number of expelled sessions to remember; it is bounded because whoever has the key can cause any number of them.
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

    /// Expels a host that broke the rules. If another of its calls has expelled it already, the first reason stands.
    fn expel(&self, session: u64, why: &str) -> Status {
        let Some(guest) = self.hub.guests().remove(&session) else {
            return self.stranger(session);
        };
        let name = guest.host().to_owned();
        tracing::error!("host {name} is expelled: {why}");
        let mut expelled = self.hub.expelled();
        expelled.push_back((session, Expelled { name, why: why.to_owned() }));
        if expelled.len() > EXPELLED {
            expelled.pop_front();
        }
        Status::permission_denied(why)
    }

    /// Has the sampled episodes of an exchange judged. Each trial runs in a task of its own, so that a host cannot
    /// stop it by ending the call.
    async fn judge(&self, exchange: &Exchange) -> Result<(), Status> {
        let session = exchange.session;
        let Some(auditor) = &self.hub.auditor else { return Ok(()) };
        if !self.hub.guests().contains_key(&session) {
            return Err(self.stranger(session));
        }
        for trajectory in &exchange.trajectories {
            let Some(trial) = auditor.trial(trajectory).await else { continue };
            let calls = self.clone();
            let tried = tokio::spawn(async move { calls.end_trial(session, trial).await });
            tried.await.map_err(internal)??;
        }
        Ok(())
    }

    /// Waits for the verdict of a trial, and expels the host if its episode differs.
    async fn end_trial(&self, session: u64, trial: Trial) -> Result<(), Status> {
        match trial.difference().await {
            None => Ok(()),
            Some(difference) => Err(self
                .expel(session, &format!("its episode differs when re-simulated: {difference}"))),
        }
    }

    /// Checks what a host says about itself.
    fn check(&self, hello: &Hello) -> Result<(), Status> {
        check_protocol(hello.protocol)?;
        let refused = |what, expected: &str, found: &str| {
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
            return refused("a name", &expected, &format!("{:?}", hello.host));
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

    /// Admits a host and returns its name in the run.
    fn admit(&self, hello: &Hello) -> Result<String, Status> {
        self.check(hello)?;
        let mut guests = self.hub.guests();
        // A host that comes back starts afresh: its earlier leases are granted to others.
        guests.remove(&hello.session);
        guests.retain(|_, guest| guest.is_there());
        self.check_room(hello.actors, guests.values())?;
        let is_taken = |name: &str| guests.values().any(|guest| guest.host() == name);
        let numbered = (2..).map(|number| format!("{}-{number}", hello.host));
        let mut names = std::iter::once(hello.host.clone()).chain(numbered);
        let host = names.find(|name| !is_taken(name)).unwrap_or_default();
        let guest = Guest::start(&self.hub.setup, &host, hello).map_err(internal)?;
        tracing::info!("host {host} joins, build {}", hello.build);
        guests.insert(hello.session, guest);
        Ok(host)
    }

    /// Returns how many actors a host is to run, according to the user's latest request.
    fn actors_of(&self, session: u64) -> Option<u64> {
        let mut guests = self.hub.guests();
        let guest = guests.get(&session)?;
        let wanted = ActorsWanted::of_host(&self.hub.setup.folder, guest.host());
        let count = match wanted.take() {
            Ok(None) => return Some(guest.actors),
            Ok(Some(count)) => count,
            Err(error) => {
                tracing::warn!("{error}");
                return Some(guest.actors);
            }
        };
        // Hosts that have left stay in the map until another host joins.
        let is_other = |(other, guest): &(&u64, &Guest)| **other != session && guest.is_there();
        let others = guests.iter().filter(is_other).map(|(_, guest)| guest);
        let room = self.check_room(count, others);
        let guest = guests.get_mut(&session)?;
        match room {
            Ok(()) => guest.actors = count,
            Err(why) => tracing::warn!("host {}: {}", guest.host(), why.message()),
        }
        Some(guest.actors)
    }
}

fn internal(error: impl Into<anyhow::Error>) -> Status {
    Status::internal(format!("{:#}", error.into()))
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
        let host = self.admit(&hello).inspect_err(|why| {
            let name = shortened(&hello.host, NAME_CHARS);
            tracing::warn!("host {name:?} is refused: {}", why.message());
        })?;
        Ok(Response::new(Welcome { host }))
    }

    async fn beat(&self, request: Request<Beat>) -> Result<Response<BeatReply>, Status> {
        let Beat { session, actors, distance_ms } = request.into_inner();
        if let Some(guest) = self.hub.guests().get_mut(&session) {
            guest.about.actors = actors.len() as u64;
            guest.about.distance_ms = distance_ms.filter(|distance| distance.is_finite());
        }
        self.done(session, |done| Order::Beat { actors, done }).await?;
        let actors = self.actors_of(session).ok_or_else(|| self.stranger(session))?;
        Ok(Response::new(BeatReply { finished: self.hub.is_finished(), actors }))
    }

    async fn exchange(&self, request: Request<Exchange>) -> Result<Response<Answer>, Status> {
        let exchange = request.into_inner();
        let session = exchange.session;
        self.judge(&exchange).await?;
        match self.done(session, |done| Order::Exchange { exchange, done }).await? {
            Ok(answer) => Ok(Response::new(answer)),
            Err(Refusal::Wrong(why)) => Err(self.expel(session, &format!("{why:#}"))),
            Err(Refusal::NoRoom(why)) => Err(Status::resource_exhausted(format!("{why:#}"))),
        }
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
