//! Asks about leases, one question at a time. It can ask again if there is no learner or it does not answer.

use std::time::{Duration, Instant};

use bytes::Bytes;
use protocol::Error;

use super::question::{Client, Pending};

/// How long to wait after finding no learner before asking again.
const ASK_AGAIN: Duration = Duration::from_millis(250);

/// How long a question stays open. It is answered once there are leases. Asking again after this time shows the
/// learner that the actor is alive, and reaches a learner that was restarted.
const PATIENCE: Duration = Duration::from_secs(5);

/// Asks the learner for leases; answers ring the doorbell that it was opened with.
#[derive(Debug)]
pub struct LeaseAsker {
    client: Client,
    open: Option<(Pending, Instant)>,
    refused: Option<Instant>,
}

impl LeaseAsker {
    pub(super) fn new(client: Client) -> LeaseAsker {
        LeaseAsker { client, open: None, refused: None }
    }

    /// Returns whether a question may be asked: none is open, and the learner was not missing a moment ago.
    pub fn is_free(&self) -> bool {
        self.open.is_none() && self.refused.is_none_or(|refused| refused.elapsed() >= ASK_AGAIN)
    }

    /// Sends a question. An earlier one that is still open is given up.
    ///
    /// # Errors
    /// When there is no learner.
    pub fn ask(&mut self, question: &[u8]) -> Result<(), Error> {
        let now = Instant::now();
        match self.client.send(question) {
            Ok(pending) => {
                (self.open, self.refused) = (Some((pending, now)), None);
                Ok(())
            }
            Err(error) => {
                (self.open, self.refused) = (None, Some(now));
                Err(error)
            }
        }
    }

    /// Gives up an open question.
    pub fn give_up(&mut self) {
        self.open = None;
    }

    /// Returns the answer to the open question, if it has arrived. An answer for which `read` returns `None` is not
    /// the learner's, whose own answer may still come.
    pub fn answer<T>(&mut self, read: impl FnOnce(Bytes) -> Option<T>) -> Option<T> {
        let (pending, since) = self.open.as_ref()?;
        let answer = match pending.poll() {
            Ok(None) if since.elapsed() < PATIENCE => return None,
            Ok(None) | Err(_) => None,
            Ok(Some(bytes)) => Some(read(bytes)?),
        };
        self.open = None;
        answer
    }
}
