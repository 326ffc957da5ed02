//! One question at a time about leases, asked again where there is no learner or none that answers.

use std::time::{Duration, Instant};

use bytes::Bytes;
use protocol::Error;

use super::question::{Client, Pending};

/// How long a learner is left alone that is not there.
const ASK_AGAIN: Duration = Duration::from_millis(250);

/// A question is answered when there are leases. One that is open for so long is given up: asking again shows
/// the learner that the actor lives, and finds a learner that was restarted.
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

    /// Whether a question may be asked: none is open, and the learner was not missing a moment ago.
    pub fn is_free(&self) -> bool {
        self.open.is_none() && self.refused.is_none_or(|refused| refused.elapsed() >= ASK_AGAIN)
    }

    /// Asks; a question that is still open is given up.
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

    /// Gives an open question up.
    pub fn give_up(&mut self) {
        self.open = None;
    }

    /// The answer to the open question. One that `read` makes nothing of is none of the learner's, whose
    /// own may still come.
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
