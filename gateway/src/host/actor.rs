//! What the desk of a host knows of one of its actors: its questions go to the hub one at a time, each with what
//! it published before, or once that is there.

use std::collections::VecDeque;

use bus::Request;
use bytes::Bytes;
use protocol::messages::{LeaseReply, LeaseRequest};

use super::Outgoing;
use crate::messages::TOGETHER_BYTES;

/// An actor of this host.
#[derive(Default)]
pub(super) struct LocalActor {
    /// Its trajectories that nobody has seen to yet.
    pub(super) trajectories: VecDeque<Bytes>,
    /// Deliveries on their way to the hub.
    on_their_way: usize,
    /// Number of its newest question at the hub.
    number: u64,
    is_asked: bool,
    /// What is to be asked next: what the actor has said since.
    next: Option<LeaseRequest>,
    /// What the hub answered, until the actor asks again: it gives a question up after a while.
    answer: Option<LeaseReply>,
    /// The question that the actor waits with.
    question: Option<Request>,
}

impl LocalActor {
    /// Takes a question of the actor's.
    pub(super) fn take(&mut self, request: LeaseRequest, question: Request) {
        self.question = Some(question);
        match &mut self.next {
            Some(next) => add(next, request),
            None => self.next = Some(request),
        }
    }

    /// What is to go to the hub next.
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

    /// The oldest trajectories: as many as fit into a message, or one that is larger.
    fn take_together(&mut self) -> Vec<Bytes> {
        let mut room = TOGETHER_BYTES;
        let mut fits = |bytes: &Bytes| {
            let fits = bytes.len() <= room;
            room = room.saturating_sub(bytes.len());
            fits
        };
        let count = self.trajectories.iter().take_while(|bytes| fits(bytes)).count();
        let count = count.max(1).min(self.trajectories.len());
        self.trajectories.drain(..count).collect()
    }

    /// A delivery is there.
    pub(super) fn delivered(&mut self) {
        self.on_their_way = self.on_their_way.saturating_sub(1);
    }

    /// The hub has answered the question of this number.
    pub(super) fn answered(&mut self, number: u64, reply: LeaseReply) {
        if number == self.number {
            self.is_asked = false;
            self.answer = Some(reply);
        }
    }

    /// The answer and whom it is for, once both are there.
    pub(super) fn take_reply(&mut self) -> Option<(Request, LeaseReply)> {
        if self.question.as_ref().is_some_and(|question| !question.is_awaited()) {
            self.question = None;
        }
        let question = self.question.take_if(|_| self.answer.is_some())?;
        Some((question, self.answer.take()?))
    }

    /// The question it waits with, whatever was answered.
    pub(super) fn take_question(&mut self) -> Option<Request> {
        self.question.take()
    }
}

/// Adds a later question of the same actor: both finished leases and seconds count.
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
    }
}
