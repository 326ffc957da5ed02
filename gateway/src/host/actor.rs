//! What the desk of a host knows of one of its actors: its questions go to the hub one at a time, each once
//! everything it published before is there.

use bus::Request;
use protocol::messages::{LeaseReply, LeaseRequest};

/// An actor of this host.
#[derive(Default)]
pub(super) struct LocalActor {
    /// Its trajectories on their way to the hub.
    pub(super) on_their_way: usize,
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

    /// The question that is to go to the hub now, with its number.
    pub(super) fn due(&mut self) -> Option<(u64, LeaseRequest)> {
        if self.is_asked
            || self.answer.is_some()
            || self.on_their_way > 0
            || self.question.is_none()
        {
            return None;
        }
        let request = self.next.take()?;
        (self.number, self.is_asked) = (self.number + 1, true);
        Some((self.number, request))
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
