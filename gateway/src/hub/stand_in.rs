//! An actor of another host, as the learner sees it: a node of its own, and one question at a time.

use std::time::{Duration, Instant};

use anyhow::Result;
use bus::{Bus, BusAddress, Client, Pending, Role};
use prost::Message;
use protocol::dropped::Dropped;
use protocol::messages::{LeaseReply, LeaseRequest};
use run::folder::RunFolder;
use tokio::sync::oneshot;

use crate::messages::Answer;

/// How long a host waits for an answer before it is told that there is none yet.
const HELD: Duration = Duration::from_secs(2);

/// How long a learner is left alone that is not there.
const ASK_AGAIN: Duration = Duration::from_millis(250);

/// Asking again after this long shows the learner that the actor lives, and finds a restarted one.
const ANSWER_PATIENCE: Duration = Duration::from_secs(5);

/// An actor of another host.
pub(super) struct StandIn {
    folder: RunFolder,
    name: String,
    leases: Client,
    number: u64,
    request: LeaseRequest,
    asked: Option<(Pending, Instant)>,
    refused: Option<Instant>,
    reply: Option<LeaseReply>,
    waiting: Option<(oneshot::Sender<Result<Answer>>, Instant)>,
    dropped: Dropped,
    /// It is there as long as this is.
    _bus: Bus,
}

impl StandIn {
    pub(super) fn open(folder: &RunFolder, address: &BusAddress, name: String) -> Result<StandIn> {
        let bus = Bus::open(address, &name)?;
        Ok(StandIn {
            folder: folder.clone(),
            name,
            leases: bus.lease_client(Role::Actors)?,
            number: 0,
            request: LeaseRequest::default(),
            asked: None,
            refused: None,
            reply: None,
            waiting: None,
            dropped: Dropped::new("answers about leases"),
            _bus: bus,
        })
    }

    /// Whether somebody waits for an answer.
    pub(super) fn is_waited_for(&self) -> bool {
        self.waiting.is_some()
    }

    /// Takes a question on. One that is asked again keeps its answer.
    pub(super) fn ask(
        &mut self,
        number: u64,
        request: LeaseRequest,
        done: oneshot::Sender<Result<Answer>>,
    ) {
        if number != self.number {
            self.request = LeaseRequest { actor: self.name.clone(), ..request };
            (self.number, self.asked, self.reply) = (number, None, None);
        }
        self.waiting = Some((done, Instant::now()));
        self.answer();
    }

    /// Looks for an answer; gives one that has just come.
    pub(super) fn look(&mut self) -> Option<LeaseReply> {
        let new = if self.reply.is_none() && self.number > 0 { self.poll() } else { None };
        self.reply = self.reply.take().or_else(|| new.clone());
        self.answer();
        new
    }

    fn poll(&mut self) -> Option<LeaseReply> {
        let Some((pending, since)) = &self.asked else { return self.send() };
        match pending.poll() {
            Ok(Some(bytes)) => match LeaseReply::decode(bytes) {
                Ok(reply) => {
                    self.asked = None;
                    return Some(reply);
                }
                // No answer of the learner's; that may still come.
                Err(why) => self.dropped.note(why),
            },
            Ok(None) if since.elapsed() < ANSWER_PATIENCE => {}
            Ok(None) | Err(_) => self.asked = None,
        }
        None
    }

    /// Asks the learner. Where none is any more, the run may be over.
    fn send(&mut self) -> Option<LeaseReply> {
        if self.refused.is_some_and(|refused| refused.elapsed() < ASK_AGAIN) {
            return None;
        }
        match self.leases.send(&self.request.encode_to_vec()) {
            Ok(pending) => {
                (self.asked, self.refused) = (Some((pending, Instant::now())), None);
                None
            }
            Err(error) => {
                tracing::debug!("no learner to ask: {error}");
                self.refused = Some(Instant::now());
                let over = || LeaseReply { finished: true, ..LeaseReply::default() };
                self.folder.summary_file().exists().then(over)
            }
        }
    }

    /// Answers whoever waits, once there is an answer, or there has been none for long.
    fn answer(&mut self) {
        let is_due = self.waiting.as_ref().is_some_and(|(_, since)| since.elapsed() >= HELD);
        if (self.reply.is_some() || is_due)
            && let Some((waiting, _)) = self.waiting.take()
        {
            // It may have hung up; then it asks again.
            waiting.send(Ok(Answer { reply: self.reply.clone() })).ok();
        }
    }
}
