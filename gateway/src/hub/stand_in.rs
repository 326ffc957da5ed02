//! An actor of another host, as the learner sees it: a node of its own with one open request at a time.

use std::time::{Duration, Instant};

use anyhow::Result;
use bus::{Bus, BusAddress, Doorbell, LeaseAsker};
use prost::Message;
use protocol::dropped::Dropped;
use protocol::messages::{LeaseReply, LeaseRequest};
use run::folder::RunFolder;
use tokio::sync::oneshot;

use crate::messages::Answer;

/// How long a request of a host is held before the host is told that there is no reply yet.
const HELD: Duration = Duration::from_secs(2);

/// Why a host gets no answer.
#[derive(Debug)]
pub(super) enum Refusal {
    /// The host sent something that is not of this run.
    Wrong(anyhow::Error),
    /// There is no room for the host's actor.
    NoRoom(anyhow::Error),
}

/// The stand-in for an actor of another host.
pub(super) struct StandIn {
    folder: RunFolder,
    name: String,
    leases: LeaseAsker,
    number: u64,
    request: LeaseRequest,
    reply: Option<LeaseReply>,
    waiting: Option<(oneshot::Sender<Result<Answer, Refusal>>, Instant)>,
    dropped: Dropped,
    /// The node is on the bus as long as this is open.
    _bus: Bus,
}

impl StandIn {
    /// Opens a stand-in. The learner's replies ring `doorbell`.
    pub(super) fn open(
        folder: &RunFolder,
        address: &BusAddress,
        name: String,
        doorbell: &Doorbell,
    ) -> Result<StandIn> {
        let bus = Bus::open(address, &name)?;
        Ok(StandIn {
            folder: folder.clone(),
            name,
            leases: bus.lease_asker(doorbell)?,
            number: 0,
            request: LeaseRequest::default(),
            reply: None,
            waiting: None,
            dropped: Dropped::new("answers about leases"),
            _bus: bus,
        })
    }

    /// Accepts a request. A repeated request keeps its reply.
    pub(super) fn ask(
        &mut self,
        number: u64,
        request: LeaseRequest,
        done: oneshot::Sender<Result<Answer, Refusal>>,
    ) {
        if number != self.number {
            self.request = LeaseRequest { actor: self.name.clone(), ..request };
            (self.number, self.reply) = (number, None);
            self.leases.give_up();
        }
        self.waiting = Some((done, Instant::now()));
    }

    /// Looks for a reply; returns it if it has just arrived.
    pub(super) fn look(&mut self) -> Option<LeaseReply> {
        let is_asked = self.number > 0 && self.reply.is_none();
        let new = is_asked.then(|| self.answer_or_ask()).flatten();
        self.reply = self.reply.take().or_else(|| new.clone());
        self.answer_host();
        new
    }

    fn answer_or_ask(&mut self) -> Option<LeaseReply> {
        let dropped = &mut self.dropped;
        let read = |bytes| LeaseReply::decode(bytes).map_err(|why| dropped.note(why)).ok();
        let reply = self.leases.answer(read);
        if reply.is_none() && self.leases.is_free() { self.ask_learner() } else { reply }
    }

    /// Sends the request to the learner. If there is none, returns a reply that ends the actor, provided that the run
    /// is over.
    fn ask_learner(&mut self) -> Option<LeaseReply> {
        let Err(error) = self.leases.ask(&self.request.encode_to_vec()) else {
            // What the actor has spent counts once, however often the request is repeated.
            self.request.seconds = None;
            return None;
        };
        tracing::debug!("no learner to ask: {error}");
        let over = || LeaseReply { finished: true, ..LeaseReply::default() };
        self.folder.summary_file().exists().then(over)
    }

    /// Answers the waiting host once there is a reply, or after [`HELD`].
    fn answer_host(&mut self) {
        let is_due = self.waiting.as_ref().is_some_and(|(_, since)| since.elapsed() >= HELD);
        if (self.reply.is_some() || is_due)
            && let Some((waiting, _)) = self.waiting.take()
        {
            // If the host has hung up, it asks again.
            waiting.send(Ok(Answer { reply: self.reply.clone() })).ok();
        }
    }
}

/// Answers a waiting request without a reply: the host is still known, and asks again if the actor is alive.
impl Drop for StandIn {
    fn drop(&mut self) {
        if let Some((waiting, _)) = self.waiting.take() {
            waiting.send(Ok(Answer::default())).ok();
        }
    }
}
