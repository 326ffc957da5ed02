//! The one loop of the service: take trajectories in, answer requests in the order they come.
//!
//! Whatever a request changes is remembered with its iteration, so that a request repeated after a
//! lost answer changes nothing more.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

use anyhow::{Context, Result, anyhow, bail};
use bytes::Bytes;
use prost::Message;
use protocol::bus::{Bus, BusAddress, Doorbell, Role, Server, SharedMemory, TrajectorySubscriber};
use protocol::config::RunConfig;
use protocol::messages::{
    Answer, Ask, Batch, Begin, Missing, Query, RewardUpdate, Scores, ServiceReply, ServiceRequest,
};
use protocol::process::Stop;
use protocol::run::RunFolder;
use protocol::task::Spec;
use protocol::tensors::Tensors;
use protocol::trajectory::{Encoded, TrajectoryKey};

use crate::model::RewardModel;

/// Longest sleep.
const TICK: Duration = Duration::from_millis(200);

/// The service of a run.
pub struct Service {
    spec: Spec,
    model: Box<dyn RewardModel>,
    fresh: Tensors,
    /// Offline training is done once, however often the learner begins afresh.
    pretrained: Option<(RewardUpdate, Tensors)>,
    /// Encoded trajectories received and not yet part of a batch.
    received: BTreeMap<TrajectoryKey, Bytes>,
    batch: Vec<Encoded>,
    batch_iteration: Option<u64>,
    improved: Option<RewardUpdate>,
    bus: Bus,
    doorbell: Doorbell<SharedMemory>,
    trajectories: TrajectorySubscriber<SharedMemory>,
    requests: Server<SharedMemory>,
}

impl Service {
    /// Opens the ports of a run's service.
    pub fn open(
        folder: &RunFolder,
        config: &RunConfig,
        model: Box<dyn RewardModel>,
    ) -> Result<Service> {
        let bus = Bus::open(&BusAddress::of_run(folder.path())?, "proximity-service")?;
        Ok(Service {
            spec: config.task.spec(),
            fresh: model.save(),
            model,
            pretrained: None,
            received: BTreeMap::new(),
            batch: Vec::new(),
            batch_iteration: None,
            improved: None,
            doorbell: bus.doorbell(Role::ProximityService)?,
            trajectories: bus.trajectory_subscriber()?,
            requests: bus.score_server()?,
            bus,
        })
    }

    /// Serves until a stop is requested and the learner, which may still save, is gone.
    pub fn serve(&mut self, stop: &Stop) -> Result<()> {
        while !(stop.is_requested() && self.learner_is_gone()?) {
            self.doorbell.wait(TICK)?;
            self.take_trajectories()?;
            while let Some(question) = self.requests.receive()? {
                self.take_trajectories()?;
                let answer = self.answer(question.bytes());
                let answer = answer.unwrap_or_else(|error| {
                    tracing::error!("refused: {error:#}");
                    Answer::Refused(format!("{error:#}"))
                });
                question.reply(&ServiceReply { answer: Some(answer) }.encode_to_vec())?;
            }
        }
        Ok(())
    }

    fn learner_is_gone(&self) -> Result<bool> {
        Ok(!self.bus.alive()?.iter().any(|name| name.starts_with("learner")))
    }

    /// Keeps what actors publish until a batch asks for it. Bytes are checked when they are used.
    fn take_trajectories(&mut self) -> Result<()> {
        while let Some((header, bytes)) = self.trajectories.receive()? {
            let key =
                TrajectoryKey { lane: header.lane, episode: header.episode, hash: header.hash };
            self.received.insert(key, bytes);
        }
        Ok(())
    }

    fn answer(&mut self, request: &[u8]) -> Result<Answer> {
        let request = ServiceRequest::decode(request).context("request")?;
        match request.ask.context("expected a request, found none")? {
            Ask::Begin(begin) => Ok(Answer::Updated(self.begin(&begin)?)),
            Ask::Batch(batch) => Ok(Answer::Missing(self.take_batch(batch)?)),
            Ask::Score(request) => {
                self.expect_batch(request.iteration)?;
                let scores = self.model.score(request.iteration, &self.batch);
                Ok(Answer::Scores(Scores { scores }))
            }
            Ask::Improve(request) => Ok(Answer::Updated(self.improve(request.iteration)?)),
            Ask::Save(save) => {
                self.model.save().save(Path::new(&save.path))?;
                Ok(Answer::Saved(self.model.sha256()))
            }
            Ask::Query(query) => self.estimate(&query),
        }
    }

    fn begin(&mut self, begin: &Begin) -> Result<RewardUpdate> {
        self.batch.clear();
        self.batch_iteration = None;
        self.improved = None;
        let restored = |model: &mut Box<dyn RewardModel>, tensors: &Tensors| {
            model.restore(tensors).map_err(|message| anyhow!(message))
        };
        if !begin.checkpoint.is_empty() {
            let tensors = Tensors::load(Path::new(&begin.checkpoint))?;
            restored(&mut self.model, &tensors)
                .with_context(|| format!("checkpoint {}", begin.checkpoint))?;
            let weights_sha256 = self.model.sha256();
            let iteration = begin.iteration;
            return Ok(RewardUpdate { iteration, weights_sha256, ..RewardUpdate::default() });
        }
        if let Some((update, tensors)) = &self.pretrained {
            restored(&mut self.model, tensors)?;
            return Ok(update.clone());
        }
        restored(&mut self.model, &self.fresh)?;
        let update = self.model.pretrain();
        self.pretrained = Some((update.clone(), self.model.save()));
        Ok(update)
    }

    /// Puts a batch together from what was received and supplied; says what is missing.
    fn take_batch(&mut self, batch: Batch) -> Result<Missing> {
        for bytes in batch.supplied {
            let encoded = Encoded::decode(bytes, &self.spec)?;
            self.received.insert(encoded.key, encoded.bytes);
        }
        let lacks = |key: &&TrajectoryKey| !self.received.contains_key(*key);
        if self.batch_iteration == Some(batch.iteration) {
            return Ok(Missing::default());
        }
        if batch.keys.iter().any(|key| lacks(&key)) {
            let positions = batch.keys.iter().enumerate().filter(|(_, key)| lacks(key));
            return Ok(Missing { positions: positions.map(|(at, _)| at as u32).collect() });
        }
        self.batch.clear();
        for key in &batch.keys {
            let bytes = self.received.remove(key).context("a batch names a trajectory twice")?;
            self.batch.push(Encoded::decode(bytes, &self.spec)?);
        }
        self.batch_iteration = Some(batch.iteration);
        self.forget_copies();
        Ok(Missing::default())
    }

    /// Drops what was received of lanes' pasts: copies of episodes that were run twice.
    fn forget_copies(&mut self) {
        let newest: BTreeMap<u64, u64> =
            self.batch.iter().map(|encoded| (encoded.key.lane, encoded.key.episode)).collect();
        let is_new = |key: &TrajectoryKey| {
            newest.get(&key.lane).is_none_or(|&episode| key.episode > episode)
        };
        self.received.retain(|key, _| is_new(key));
    }

    fn expect_batch(&self, iteration: u64) -> Result<()> {
        match self.batch_iteration {
            Some(found) if found == iteration => Ok(()),
            found => bail!("expected a request about iteration {found:?}, found {iteration}"),
        }
    }

    fn improve(&mut self, iteration: u64) -> Result<RewardUpdate> {
        self.expect_batch(iteration)?;
        if let Some(update) = self.improved.as_ref().filter(|update| update.iteration == iteration)
        {
            return Ok(update.clone());
        }
        let update = self.model.improve(iteration, &self.batch);
        self.improved = Some(update.clone());
        Ok(update)
    }

    fn estimate(&self, query: &Query) -> Result<Answer> {
        self.spec.observation.check(&query.observations)?;
        Ok(Answer::Estimates(self.model.estimate(&query.observations)?))
    }
}
