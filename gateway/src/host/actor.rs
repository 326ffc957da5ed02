//! An actor of this host as its desk knows it. The actor's lease requests go to the hub one at a time, each together
//! with the trajectories that the actor published before, or after the hub has acknowledged them.

use std::collections::VecDeque;

use bus::Request;
use bytes::Bytes;
use protocol::messages::{LeaseReply, LeaseRequest};

use super::Outgoing;
use crate::messages::{TOGETHER, TOGETHER_BYTES};

/// An actor of this host.
#[derive(Default)]
pub(super) struct LocalActor {
    /// Its trajectories that are not yet on their way to the hub.
    pub(super) trajectories: VecDeque<Bytes>,
    /// Number of deliveries on their way to the hub.
    on_their_way: usize,
    /// Number of its newest request at the hub.
    number: u64,
    is_asked: bool,
    /// The next request to the hub: what the actor has asked since the newest one.
    next: Option<LeaseRequest>,
    /// The hub's reply, kept until the actor asks again, because an actor gives up a request after a while.
    answer: Option<LeaseReply>,
    /// The actor's request that awaits a reply.
    question: Option<Request>,
}

impl LocalActor {
    /// Accepts a request of the actor.
    pub(super) fn take(&mut self, request: LeaseRequest, question: Request) {
        self.question = Some(question);
        match &mut self.next {
            Some(next) => add(next, request),
            None => self.next = Some(request),
        }
    }

    /// Returns what is to go to the hub next.
    pub(super) fn due(&mut self, name: &str) -> Option<Outgoing> {
        let trajectories = self.take_together();
        let can_ask = !self.is_asked
            && self.answer.is_none()
            && self.on_their_way == 0
            && self.trajectories.is_empty()
            && self.question.is_some();
        if let Some(request) = self.next.take_if(|_| can_ask) {
            (self.number, self.is_asked) = (self.number + 1, true);
            return Some(Outgoing::Ask { number: self.number, request, trajectories });
        }
        if trajectories.is_empty() {
            return None;
        }
        self.on_their_way += 1;
        Some(Outgoing::Deliver { actor: name.to_owned(), trajectories })
    }

    /// Takes the oldest trajectories: as many as fit into a message, or a single larger one.
    fn take_together(&mut self) -> Vec<Bytes> {
        let mut room = TOGETHER_BYTES;
        let mut fits = |bytes: &Bytes| {
            let fits = bytes.len() <= room;
            room = room.saturating_sub(bytes.len());
            fits
        };
        let oldest = self.trajectories.iter().take(TOGETHER);
        let count = oldest.take_while(|bytes| fits(bytes)).count();
        let count = count.max(1).min(self.trajectories.len());
        self.trajectories.drain(..count).collect()
    }

    /// Notes that a delivery has arrived.
    pub(super) fn delivered(&mut self) {
        self.on_their_way = self.on_their_way.saturating_sub(1);
    }

    /// Notes the hub's reply to the request with this number.
    pub(super) fn answered(&mut self, number: u64, reply: LeaseReply) {
        if number == self.number {
            self.is_asked = false;
            self.answer = Some(reply);
        }
    }

    /// Returns the reply and the request it answers, once there are both.
    pub(super) fn take_reply(&mut self) -> Option<(Request, LeaseReply)> {
        if self.question.as_ref().is_some_and(|question| !question.is_awaited()) {
            self.question = None;
        }
        let question = self.question.take_if(|_| self.answer.is_some())?;
        Some((question, self.answer.take()?))
    }

    /// Returns the waiting request, whether or not there is a reply.
    pub(super) fn take_question(&mut self) -> Option<Request> {
        self.question.take()
    }
}

/// Adds a later request of the same actor: the finished leases and the seconds of both count.
fn add(request: &mut LeaseRequest, later: LeaseRequest) {
    request.capacity = later.capacity;
    request.finished.extend(later.finished);
    let mut seconds = request.seconds.unwrap_or_default();
    seconds.add(&later.seconds.unwrap_or_default());
    request.seconds = Some(seconds);
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may panic")]
mod tests {
    use super::*;

    fn sizes(actor: &mut LocalActor) -> Vec<usize> {
        actor.take_together().iter().map(Bytes::len).collect()
    }

    #[test]
    fn trajectories_go_together_as_far_as_they_fit() {
        let mut actor = LocalActor::default();
        assert!(actor.due("actor-0").is_none());
        let of = |bytes: usize| Bytes::from(vec![0; bytes]);
        let third = TOGETHER_BYTES / 3;
        actor.trajectories.extend([third, third, third, third, 2 * TOGETHER_BYTES, 7].map(of));
        assert_eq!(sizes(&mut actor), [third; 3]);
        assert_eq!(sizes(&mut actor), [third]);
        assert_eq!(sizes(&mut actor), [2 * TOGETHER_BYTES]);
        let Some(Outgoing::Deliver { actor: name, trajectories }) = actor.due("actor-0") else {
            panic!("expected a delivery");
        };
        assert_eq!((name.as_str(), trajectories), ("actor-0", vec![of(7)]));
        assert!(sizes(&mut actor).is_empty());
        actor.trajectories.extend(vec![of(7); TOGETHER + 1]);
        assert_eq!(sizes(&mut actor).len(), TOGETHER);
        assert_eq!(sizes(&mut actor), [7]);
    }
}
