//! The learner's side of the proximity service: batches named, scores fetched, training ordered.

use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};
use prost::Message;
use protocol::bus::{Bus, Client, Doorbell, Pending, Role, SharedMemory};
use protocol::messages::{
    Answer, Ask, Batch, Begin, IterationRequest, RewardUpdate, Save, Score, ServiceReply,
    ServiceRequest,
};
use protocol::trajectory::{Encoded, TrajectoryKey};

/// Longest wait for a single answer; offline training of a large demonstration set is the longest.
const DEADLINE: Duration = Duration::from_secs(600);

/// How often a dead service is looked for while an answer is awaited.
const LOOK_AGAIN: Duration = Duration::from_millis(200);

/// The learner's side of the proximity service.
pub struct Scoring {
    bus: Bus,
    client: Client<SharedMemory>,
    doorbell: Doorbell<SharedMemory>,
}

/// Training of the reward model, under way while the policy is updated.
pub struct Improvement(Pending<SharedMemory>);

/// The service lives and could not do what it was asked.
#[derive(Debug, thiserror::Error)]
#[error("the proximity service refused: {0}")]
pub struct Refused(String);

impl Scoring {
    /// Opens the client over the trainer's bus.
    pub fn open(bus: Bus) -> Result<Scoring> {
        let client = bus.score_client(Role::Learner)?;
        let doorbell = bus.doorbell(Role::Learner)?;
        Ok(Scoring { bus, client, doorbell })
    }

    /// Brings the service to the state after `iteration` iterations.
    pub fn begin(&self, iteration: u64, checkpoint: &str) -> Result<RewardUpdate> {
        let begin = Begin { iteration, checkpoint: checkpoint.to_owned() };
        match self.ask(Ask::Begin(begin))? {
            Answer::Updated(update) => Ok(update),
            other => bail!("begin: expected an update, found {other:?}"),
        }
    }

    /// Makes a batch the service's current one. It has most trajectories from the actors; those it
    /// lacks are sent again.
    pub fn announce(&self, iteration: u64, trajectories: &[Encoded]) -> Result<()> {
        let keys: Vec<TrajectoryKey> = trajectories.iter().map(|encoded| encoded.key).collect();
        let mut supplied = Vec::new();
        for _ in 0..2 {
            let batch = Batch { iteration, keys: keys.clone(), supplied };
            let missing = match self.ask(Ask::Batch(batch))? {
                Answer::Missing(missing) => missing.positions,
                other => bail!("batch {iteration}: expected what is missing, found {other:?}"),
            };
            if missing.is_empty() {
                return Ok(());
            }
            tracing::info!("iteration {iteration}: {} trajectories sent again", missing.len());
            let bytes = |position: &u32| Some(trajectories.get(*position as usize)?.bytes.clone());
            supplied = missing.iter().filter_map(bytes).collect();
        }
        bail!("batch {iteration}: the service lacks trajectories it was sent")
    }

    /// Scores of the current batch, in batch order.
    pub fn scores(&self, iteration: u64, trajectories: &[Encoded]) -> Result<Vec<Score>> {
        let scores = match self.ask(Ask::Score(IterationRequest { iteration }))? {
            Answer::Scores(scores) => scores.scores,
            other => bail!("score {iteration}: expected scores, found {other:?}"),
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
    pub fn start_improving(&self, iteration: u64) -> Result<Improvement> {
        let ask = Ask::Improve(IterationRequest { iteration });
        let request = ServiceRequest { ask: Some(ask) }.encode_to_vec();
        Ok(Improvement(self.client.send(&request)?))
    }

    /// Waits for the training to end.
    pub fn improved(&self, improvement: Improvement) -> Result<RewardUpdate> {
        loop {
            if let Some(bytes) = improvement.0.poll()? {
                return match answer(&bytes)? {
                    Answer::Updated(update) => Ok(update),
                    other => bail!("improve: expected an update, found {other:?}"),
                };
            }
            self.doorbell.wait(LOOK_AGAIN)?;
            self.bus.clean_up();
        }
    }

    /// Has the service write its checkpoint file; returns the hash of its weights.
    ///
    /// # Errors
    /// [`Refused`] if the service cannot write it.
    pub fn save(&self, path: &str) -> Result<String> {
        match self.ask(Ask::Save(Save { path: path.to_owned() }))? {
            Answer::Saved(sha256) => Ok(sha256),
            other => bail!("save: expected a hash, found {other:?}"),
        }
    }

    fn ask(&self, ask: Ask) -> Result<Answer> {
        let request = ServiceRequest { ask: Some(ask) }.encode_to_vec();
        answer(&self.client.ask(&request, DEADLINE, &self.doorbell)?)
    }
}

fn answer(bytes: &[u8]) -> Result<Answer> {
    match ServiceReply::decode(bytes).context("reply of the proximity service")?.answer {
        Some(Answer::Refused(why)) => Err(Refused(why).into()),
        Some(answer) => Ok(answer),
        None => bail!("expected an answer of the proximity service, found none"),
    }
}
