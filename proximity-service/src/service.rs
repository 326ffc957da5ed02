//! The main loop of the service: receives trajectories and answers requests in the order they come.
//!
//! The result of a request that changes something is remembered with its iteration, so a request repeated after a
//! lost answer changes nothing further. Invalid input is refused or dropped, and the service continues.

use std::fmt::Display;
use std::path::Path;
use std::time::Duration;

use anyhow::{Context, Result, anyhow, bail, ensure};
use bus::{Bus, Doorbell, Published, Request, Role, Server, TrajectorySubscriber};
use prost::Message;
use protocol::dropped::Dropped;
use protocol::messages::{
    Answer, Ask, Begin, Pretraining, Query, RewardUpdate, Saved, Score, Scores, ServiceReply,
    ServiceRequest,
};
use protocol::task::Spec;
use protocol::tensors::Tensors;
use protocol::trajectory::TrajectoryKey;
use run::config::RunConfig;
use run::folder::RunFolder;
use run::process::{Final, Stop};
use run::process_stat::ProcessorClock;

use crate::intake::Intake;
use crate::model::{RewardModel, Slice};
use crate::offline_file::OfflineFile;

/// Maximum number of trajectories taken from the bus at a time.
const TAKEN_AT_ONCE: usize = 1024;

/// Longest wait for a notification.
const TICK: Duration = Duration::from_millis(200);

/// Duration of a slice of offline training, after which requests are served.
const SLICE: Duration = Duration::from_millis(100);

/// Maximum number of bytes of trajectories kept that no batch has asked for yet. Trajectories beyond it are
/// dropped, and the learner sends them again.
const MOST_RECEIVED_BYTES: usize = 256 << 20;

/// Maximum number of observations in one query, each of which passes through every layer of every member.
const MOST_QUERIED: usize = 4096;

/// The proximity service of a run.
pub(crate) struct Service {
    spec: Spec,
    /// Number of iterations whose trajectories a batch may ask for; none of a learner that does not act.
    iterations: u64,
    model: Box<dyn RewardModel>,
    fresh: Tensors,
    offline: OfflineTraining,
    offline_file: OfflineFile,
    intake: Intake,
    dropped: Dropped,
    dropped_questions: Dropped,
    /// Whether the learner has begun, so that the model is in the state that its other requests are about.
    is_begun: bool,
    improved: Option<RewardUpdate>,
    clock: ProcessorClock,
    bus: Bus,
    doorbell: Doorbell,
    trajectories: TrajectorySubscriber,
    requests: Server,
}

/// State of offline training. Its result is kept, so that a learner that starts again does not repeat it.
enum OfflineTraining {
    /// Not requested yet.
    Idle,
    /// Under way, in slices between requests.
    UnderWay(Pretraining),
    /// Finished: the losses, and the trained model.
    Done(RewardUpdate, Tensors),
    /// The model diverged.
    Diverged(Final),
}

impl Service {
    /// Opens the ports of a run's service.
    ///
    /// # Errors
    /// When the bus fails.
    pub(crate) fn open(
        folder: &RunFolder,
        config: &RunConfig,
        bus: Bus,
        model: Box<dyn RewardModel>,
    ) -> Result<Service> {
        let fresh = model.save();
        Ok(Service {
            spec: config.task.spec(),
            iterations: if config.learner.acts() { config.iterations() } else { 0 },
            offline: OfflineTraining::Idle,
            offline_file: OfflineFile::new(folder.offline_file(), &fresh),
            fresh,
            model,
            intake: Intake::new(config.task.spec()),
            dropped: Dropped::new("trajectories from the bus"),
            dropped_questions: Dropped::new("questions"),
            is_begun: false,
            improved: None,
            clock: ProcessorClock::default(),
            doorbell: bus.doorbell(Role::ProximityService)?,
            trajectories: bus.learning_subscriber()?,
            requests: bus.score_server()?,
            bus,
        })
    }

    /// Serves until a stop is requested and the learner, which may still save, is gone.
    ///
    /// # Errors
    /// When the bus fails.
    pub(crate) fn serve(&mut self, stop: &Stop) -> Result<()> {
        while !(stop.is_requested() && self.learner_is_gone()?) {
            let trains =
                matches!(self.offline, OfflineTraining::UnderWay(_)) && !stop.is_requested();
            self.doorbell.wait(if trains { Duration::ZERO } else { TICK })?;
            self.take_trajectories()?;
            while let Some(question) = self.next_question() {
                self.take_trajectories()?;
                let answer = self.answer(question.bytes(), question.asker());
                let answer = answer.unwrap_or_else(|error| refusal(&error));
                let reply = ServiceReply { answer: Some(answer) }.encode_to_vec();
                if let Err(error) = question.reply(&reply) {
                    tracing::warn!("an answer found no place: {error}");
                }
            }
            // A checkpoint of the learner has the weights, so there is nothing left to train.
            if trains && matches!(self.offline, OfflineTraining::UnderWay(_)) {
                self.train_offline(SLICE);
            }
        }
        if let OfflineTraining::UnderWay(_) = self.offline {
            self.keep_offline();
        }
        Ok(())
    }

    /// Returns the next request, if there is one. A client that cannot be connected does not end the service.
    fn next_question(&mut self) -> Option<Request> {
        self.requests.receive().unwrap_or_else(|why| {
            self.dropped_questions.note(why);
            None
        })
    }

    /// Runs a slice of offline training.
    fn train_offline(&mut self, time: Duration) {
        self.offline = match self.model.pretrain(time) {
            Ok(Slice::Done(update)) => {
                let processor_s = self.offline_file.spend(self.clock.lap());
                OfflineTraining::Done(RewardUpdate { processor_s, ..update }, self.model.save())
            }
            Ok(Slice::UnderWay(standing)) => OfflineTraining::UnderWay(standing),
            Err(diverged) => OfflineTraining::Diverged(diverged),
        };
        if let OfflineTraining::UnderWay(_) = self.offline
            && self.offline_file.is_due()
        {
            self.keep_offline();
        }
    }

    fn keep_offline(&mut self) {
        self.offline_file.spend(self.clock.lap());
        self.offline_file.save(self.model.save());
    }

    fn learner_is_gone(&self) -> Result<bool> {
        Ok(!self.bus.alive()?.iter().any(|name| name.starts_with("learner")))
    }

    /// Receives trajectories from actors and keeps them until a batch asks for them. No batch asks for evaluation
    /// episodes, which come after the last iteration.
    fn take_trajectories(&mut self) -> Result<()> {
        let mut kept = self.intake.received_bytes();
        for _ in 0..TAKEN_AT_ONCE {
            let Some(Published { header, bytes, process }) = self.trajectories.receive()? else {
                break;
            };
            if header.iteration >= self.iterations {
                continue;
            }
            if kept + bytes.len() > MOST_RECEIVED_BYTES {
                let most = MOST_RECEIVED_BYTES >> 20;
                self.dropped
                    .note(format!("process {process}: more than {most} MiB wait for a batch"));
                continue;
            }
            kept += bytes.len();
            let key =
                TrajectoryKey { lane: header.lane, episode: header.episode, hash: header.hash };
            self.intake.receive(key, bytes);
        }
        Ok(())
    }

    fn answer(&mut self, request: &[u8], asker: Option<Role>) -> Result<Answer> {
        let request = ServiceRequest::decode(request).context("request")?;
        let ask = request.ask.context("expected a request, found none")?;
        if !matches!(ask, Ask::Query(_)) && asker != Some(Role::Learner) {
            bail!("expected a query, for only the learner asks for more; found another request");
        }
        match ask {
            Ask::Begin(begin) => {
                let answer = self.begin(&begin);
                self.is_begun = matches!(answer, Ok(Answer::Updated(_)));
                answer
            }
            Ask::Batch(batch) => {
                // Scores and updates need a batch. A refused save would count as a full disk, so the learner checks
                // what was saved.
                self.expect_begun(format_args!("the batch of iteration {}", batch.iteration))?;
                Ok(Answer::Missing(self.intake.take(batch)?))
            }
            Ask::Score(request) => {
                let batch = self.intake.batch(request.iteration)?;
                let scores = self.model.score(request.iteration, batch);
                scores.iter().try_for_each(expect_finite)?;
                Ok(Answer::Scores(Scores { scores }))
            }
            Ask::Improve(request) => Ok(Answer::Updated(self.improve(request.iteration)?)),
            Ask::Save(save) => {
                let tensors = self.model.save();
                let diverged = |message| Final(format!("the reward model diverged: {message}"));
                tensors.expect_finite().map_err(diverged)?;
                let file_sha256 = tensors.save(Path::new(&save.path))?;
                Ok(Answer::Saved(Saved { weights_sha256: self.model.sha256(), file_sha256 }))
            }
            Ask::Query(query) => self.estimate(&query),
        }
    }

    /// Refuses what needs the run's model before the learner has begun: it is still trained offline, or not restored.
    fn expect_begun(&self, found: impl Display) -> Result<()> {
        ensure!(self.is_begun, "expected the learner to begin first, found {found}");
        Ok(())
    }

    fn begin(&mut self, begin: &Begin) -> Result<Answer> {
        self.intake.begin_anew();
        self.improved = None;
        if !begin.checkpoint.is_empty() {
            self.offline = OfflineTraining::Idle;
            let tensors = Tensors::load(Path::new(&begin.checkpoint))?;
            restore(&mut *self.model, &tensors)
                .with_context(|| format!("checkpoint {}", begin.checkpoint))?;
            let weights_sha256 = self.model.sha256();
            let iteration = begin.iteration;
            let update = RewardUpdate { iteration, weights_sha256, ..RewardUpdate::default() };
            return Ok(Answer::Updated(update));
        }
        if let OfflineTraining::Idle = self.offline {
            let kept = self.offline_file.load();
            restore(&mut *self.model, kept.as_ref().unwrap_or(&self.fresh))?;
            self.train_offline(Duration::ZERO);
        }
        match &self.offline {
            OfflineTraining::Done(update, tensors) => {
                restore(&mut *self.model, tensors)?;
                Ok(Answer::Updated(update.clone()))
            }
            OfflineTraining::Diverged(diverged) => Err(diverged.clone().into()),
            OfflineTraining::UnderWay(standing) => Ok(Answer::Pretraining(*standing)),
            OfflineTraining::Idle => bail!("expected offline training to have begun"),
        }
    }

    fn improve(&mut self, iteration: u64) -> Result<RewardUpdate> {
        let batch = self.intake.batch(iteration)?;
        if let Some(update) = self.improved.as_ref().filter(|update| update.iteration == iteration)
        {
            return Ok(update.clone());
        }
        let improved = self.model.improve(iteration, batch);
        let update = improved.with_context(|| format!("iteration {iteration}"))?;
        let update = RewardUpdate { processor_s: self.clock.lap(), ..update };
        self.improved = Some(update.clone());
        Ok(update)
    }

    fn estimate(&self, query: &Query) -> Result<Answer> {
        self.expect_begun("a query")?;
        let count = query.observations.len() / self.spec.observation.bytes();
        ensure!(
            count <= MOST_QUERIED,
            "expected at most {MOST_QUERIED} observations in a query, found {count}"
        );
        self.spec.observation.check(&query.observations)?;
        Ok(Answer::Estimates(self.model.estimate(&query.observations)?))
    }
}

fn restore(model: &mut dyn RewardModel, tensors: &Tensors) -> Result<()> {
    model.restore(tensors).map_err(|message| anyhow!(message))
}

/// Refuses a score with numbers that are not finite.
fn expect_finite(score: &Score) -> Result<(), Final> {
    let Score { iteration, lane, episode, rewards, proximity, uncertainty, .. } = score;
    let all = [("reward", rewards), ("proximity", proximity), ("uncertainty", uncertainty)];
    for (what, numbers) in all {
        if let Some(index) = numbers.iter().position(|number| !number.is_finite()) {
            let found = numbers[index];
            return Err(Final(format!(
                "the reward model diverged: iteration {iteration}, lane {lane} episode {episode}, \
                 {what} {index}: expected a finite number, found {found}"
            )));
        }
    }
    Ok(())
}

/// Converts an error into the answer to a request that cannot be served.
fn refusal(error: &anyhow::Error) -> Answer {
    tracing::error!("refused: {error:#}");
    let message = format!("{error:#}");
    if error.chain().any(|cause| cause.is::<Final>()) {
        Answer::Final(message)
    } else {
        Answer::Refused(message)
    }
}

#[cfg(test)]
mod tests {
    use bus::{BusAddress, TrajectoryHeader};
    use protocol::messages::{BatchRequest, Missing};
    use protocol::trajectory::{Encoded, Source, Trajectory};
    use run::tasks::of_text;

    use super::*;
    use crate::model::FixedReward;
    use crate::tests::{CORRIDOR_FILE, walk};

    /// Calls `check` with a service of a run of `method` and another member of its bus.
    fn with_service(method: &str, check: impl FnOnce(&mut Service, &Bus)) {
        let home = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(home.path());
        let address = BusAddress::for_start(folder.path()).unwrap();
        let config =
            of_text(CORRIDOR_FILE, "corridor", None, &[format!("method={method}")]).unwrap();
        let [own, other] = ["service", "other"].map(|name| Bus::open(&address, name).unwrap());
        let model = Box::new(FixedReward::Environment);
        let mut service = Service::open(&folder, &config, own, model).unwrap();
        check(&mut service, &other);
        drop((service, other));
        address.remove().unwrap();
    }

    #[test]
    fn a_batch_is_refused_unless_the_learner_has_begun() {
        with_service("environment-reward", |service, _| {
            let mut answer = |ask: Ask| {
                let request = ServiceRequest { ask: Some(ask) }.encode_to_vec();
                service.answer(&request, Some(Role::Learner))
            };
            let batch = || Ask::Batch(BatchRequest { iteration: 3, ..BatchRequest::default() });
            let message = answer(batch()).unwrap_err().to_string();
            assert!(message.ends_with("found the batch of iteration 3"), "{message}");
            answer(Ask::Begin(Begin::default())).unwrap();
            assert_eq!(answer(batch()).unwrap(), Answer::Missing(Missing::default()));
            let gone = Begin { iteration: 1, checkpoint: "no such file".to_owned() };
            assert!(answer(Ask::Begin(gone)).is_err());
            assert!(answer(batch()).is_err(), "the model may be in any state");
        });
    }

    #[test]
    fn episodes_that_no_batch_will_ask_for_are_not_kept() {
        for (method, kept) in [("environment-reward", 1), ("bc", 0)] {
            with_service(method, |service, other| {
                let publisher = other.rollout_publisher(Duration::from_secs(1)).unwrap();
                let episode = |iteration| {
                    Encoded::encode(Trajectory { iteration, ..walk(0.0, Source::Training) })
                };
                let end = service.iterations.max(1);
                let episodes = [end - 1, end].map(episode);
                for encoded in &episodes {
                    publisher.publish(&encoded.bytes, TrajectoryHeader::from(encoded)).unwrap();
                }
                service.take_trajectories().unwrap();
                let bytes: usize = episodes[..kept].iter().map(|one| one.bytes.len()).sum();
                assert_eq!(service.intake.received_bytes(), bytes, "{method}");
            });
        }
    }
}
