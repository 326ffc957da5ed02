//! The learner's side of the proximity service: it names batches, fetches scores and orders training.

use std::time::{Duration, Instant};

use anyhow::{Result, bail, ensure};
use bus::{Bus, Client, Doorbell, Pending, Role, SERVICE_NAME};
use bytes::Bytes;
use prost::Message;
use protocol::messages::{
    Answer, Ask, BatchRequest, Begin, IterationRequest, Pretraining, RewardUpdate, Save, Saved,
    Score, ServiceReply, ServiceRequest,
};
use protocol::trajectory::{Encoded, TrajectoryKey};
use run::process::{Final, Stop};

/// How often a waiting learner checks whether the service is alive and whether it has to stop itself.
const LOOK_AGAIN: Duration = Duration::from_millis(200);

/// How long to wait for a service that is not on the bus. A service that is there is working, however long it takes.
const ABSENCE_PATIENCE: Duration = Duration::from_secs(30);

/// How long to wait for an answer once a stop is requested.
const STOP_PATIENCE: Duration = Duration::from_secs(60);

/// The learner's side of the proximity service.
pub(crate) struct ServiceClient {
    bus: Bus,
    client: Client,
    doorbell: Doorbell,
    stop: Stop,
}

/// Training of the reward model in progress.
pub(crate) struct Improvement(Pending);

/// The state of the service when it is asked to begin.
pub(crate) enum Begun {
    /// It is training offline and has to be asked again.
    Pretraining(Pretraining),
    /// It has reached the state that it was asked for.
    Ready(RewardUpdate),
}

/// The service is alive but could not do what it was asked.
#[derive(Debug, thiserror::Error)]
#[error("the proximity service refused: {0}")]
pub(crate) struct Refused(String);

impl ServiceClient {
    /// Opens the client over the trainer's bus. Once `stop` is requested, it does not wait for a service that is gone.
    ///
    /// # Errors
    /// When the bus fails.
    pub(crate) fn open(bus: Bus, stop: &Stop) -> Result<ServiceClient> {
        let doorbell = bus.doorbell(Role::Learner)?;
        let client = bus.score_client(&doorbell)?;
        Ok(ServiceClient { bus, client, doorbell, stop: stop.clone() })
    }

    /// Brings the service to the state after `iteration` iterations.
    ///
    /// # Errors
    /// When the service refuses, is gone, or the bus fails.
    pub(crate) fn begin(&self, iteration: u64, checkpoint: &str) -> Result<Begun> {
        let begin = Begin { iteration, checkpoint: checkpoint.to_owned() };
        match self.ask(Ask::Begin(begin))? {
            Answer::Updated(update) => Ok(Begun::Ready(update)),
            Answer::Pretraining(pretraining) => Ok(Begun::Pretraining(pretraining)),
            other => bail!("begin: expected an update, found {}", kind(&other)),
        }
    }

    /// Makes a batch the service's current one. The service has most trajectories from the actors; those it
    /// lacks are sent again.
    ///
    /// # Errors
    /// As [`ServiceClient::begin`], and when the service still lacks trajectories that it was sent.
    pub(crate) fn announce(&self, iteration: u64, trajectories: &[Encoded]) -> Result<()> {
        let keys: Vec<TrajectoryKey> = trajectories.iter().map(|encoded| encoded.key).collect();
        let mut supplied = Vec::new();
        for _ in 0..2 {
            let batch = BatchRequest { iteration, keys: keys.clone(), supplied };
            let missing = match self.ask(Ask::Batch(batch))? {
                Answer::Missing(missing) => missing.positions,
                other => {
                    bail!("batch {iteration}: expected what is missing, found {}", kind(&other))
                }
            };
            if missing.is_empty() {
                return Ok(());
            }
            tracing::info!("iteration {iteration}: {} trajectories sent again", missing.len());
            let bytes = |position: &u32| Some(trajectories.get(*position as usize)?.bytes.clone());
            supplied = missing.iter().filter_map(bytes).collect();
        }
        bail!(
            "batch {iteration}: expected the service to have its {} trajectories, found that it lacks \
             some that it was sent",
            trajectories.len()
        )
    }

    /// Returns the scores of the current batch, in batch order.
    ///
    /// # Errors
    /// As [`ServiceClient::begin`], and when there are not as many scores as trajectories.
    pub(crate) fn scores(&self, iteration: u64, trajectories: &[Encoded]) -> Result<Vec<Score>> {
        let scores = match self.ask(Ask::Score(IterationRequest { iteration }))? {
            Answer::Scores(scores) => scores.scores,
            other => bail!("score {iteration}: expected scores, found {}", kind(&other)),
        };
        ensure!(
            scores.len() == trajectories.len(),
            "score {iteration}: expected {}, found {}",
            trajectories.len(),
            scores.len()
        );
        Ok(scores)
    }

    /// Starts the training of the reward model on the current batch (Eq. 4).
    ///
    /// # Errors
    /// When the bus fails.
    pub(crate) fn start_improving(&self, iteration: u64) -> Result<Improvement> {
        let ask = Ask::Improve(IterationRequest { iteration });
        let request = ServiceRequest { ask: Some(ask) }.encode_to_vec();
        Ok(Improvement(self.client.send(&request)?))
    }

    /// Waits for the training to end and returns its result.
    ///
    /// # Errors
    /// As [`ServiceClient::begin`].
    pub(crate) fn improved(&self, improvement: Improvement) -> Result<RewardUpdate> {
        let mut wait = Wait::default();
        loop {
            if let Some(answer) = improvement.0.poll()?.and_then(answer) {
                return match unless_refused(answer)? {
                    Answer::Updated(update) => Ok(update),
                    other => bail!("improve: expected an update, found {}", kind(&other)),
                };
            }
            self.doorbell.wait(LOOK_AGAIN)?;
            self.expect_service(&mut wait)?;
        }
    }

    /// Has the service write its checkpoint file; returns the hashes of its weights and of the file.
    ///
    /// # Errors
    /// [`Refused`] if the service cannot write it.
    pub(crate) fn save(&self, path: &str) -> Result<Saved> {
        match self.ask(Ask::Save(Save { path: path.to_owned() }))? {
            Answer::Saved(saved) => Ok(saved),
            other => bail!("save: expected hashes, found {}", kind(&other)),
        }
    }

    /// Asks until there is an answer; asks again if the service has died, or has appeared since.
    fn ask(&self, ask: Ask) -> Result<Answer> {
        let request = ServiceRequest { ask: Some(ask) }.encode_to_vec();
        let mut wait = Wait::default();
        let keep_waiting = || self.expect_service(&mut wait);
        unless_refused(self.client.ask(&request, &self.doorbell, answer, keep_waiting)?)
    }

    /// Fails if the service has been gone for too long to go on waiting.
    fn expect_service(&self, wait: &mut Wait) -> Result<()> {
        let now = Instant::now();
        if wait.looked.is_some_and(|looked| now.duration_since(looked) < LOOK_AGAIN) {
            return Ok(());
        }
        wait.looked = Some(now);
        self.bus.clean_up();
        let is_there = self.bus.alive()?.iter().any(|name| name == SERVICE_NAME);
        wait.expect(is_there, self.stop.is_requested(), now)
    }
}

/// The state of a wait for an answer.
#[derive(Debug, Default)]
struct Wait {
    looked: Option<Instant>,
    absent_since: Option<Instant>,
    stopping_since: Option<Instant>,
}

impl Wait {
    /// Notes whether the service is there and whether a stop is requested.
    ///
    /// # Errors
    /// When there is nothing more to wait for.
    fn expect(&mut self, is_there: bool, is_stopping: bool, now: Instant) -> Result<()> {
        let since = |condition: bool, start: &mut Option<Instant>| match condition {
            true => now.duration_since(*start.get_or_insert(now)),
            false => {
                *start = None;
                Duration::ZERO
            }
        };
        let absent = since(!is_there, &mut self.absent_since);
        let stopping = since(is_stopping, &mut self.stopping_since);
        ensure!(
            is_there || (!is_stopping && absent < ABSENCE_PATIENCE),
            "expected the proximity service on the bus, found none"
        );
        ensure!(
            stopping < STOP_PATIENCE,
            "expected an answer of the proximity service within {} s of the stop, found none",
            STOP_PATIENCE.as_secs()
        );
        Ok(())
    }
}

/// Decodes the service's answer; returns `None` if the bytes are not an answer, and so are not from the service.
fn answer(bytes: Bytes) -> Option<Answer> {
    let answer = ServiceReply::decode(bytes).ok().and_then(|reply| reply.answer);
    if answer.is_none() {
        tracing::warn!("dropped what is no answer of the proximity service");
    }
    answer
}

/// Names the kind of an answer for a message, because its content may be a whole batch.
fn kind(answer: &Answer) -> &'static str {
    match answer {
        Answer::Updated(_) => "an update",
        Answer::Missing(_) => "what is missing",
        Answer::Scores(_) => "scores",
        Answer::Saved(_) => "hashes",
        Answer::Estimates(_) => "estimates",
        Answer::Refused(_) | Answer::Final(_) => "a refusal",
        Answer::Pretraining(_) => "offline training",
    }
}

fn unless_refused(answer: Answer) -> Result<Answer> {
    match answer {
        Answer::Refused(why) => Err(Refused(why).into()),
        Answer::Final(why) => Err(Final(why).into()),
        answer => Ok(answer),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_service_that_works_is_waited_for_and_one_that_is_gone_is_not() {
        let start = Instant::now();
        let hours = |hours: u64| start + Duration::from_secs(3600 * hours);
        let mut wait = Wait::default();
        for hour in 0..24 {
            wait.expect(true, false, hours(hour)).unwrap();
        }
        wait.expect(false, false, hours(24)).unwrap();
        let late = wait.expect(false, false, hours(24) + ABSENCE_PATIENCE).unwrap_err();
        assert!(late.to_string().contains("found none"), "{late}");
        assert!(Wait::default().expect(false, true, start).is_err(), "nobody restarts it");
        let mut stopping = Wait::default();
        stopping.expect(true, true, start).unwrap();
        assert!(stopping.expect(true, true, start + STOP_PATIENCE).is_err());
    }
}
