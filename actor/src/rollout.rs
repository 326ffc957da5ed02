//! `goalward-actor rollout`: pulls leases from the learner and publishes their trajectories.
//!
//! An actor keeps several lanes going at once, so that inference is batched, and asks for more as
//! lanes come free: faster actors take more. It may come and go at any moment; what it leaves undone
//! the learner hands out again.

use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use prost::Message;
use protocol::bus::{
    Bus, BusAddress, Client, Doorbell, NewestSubscriber, Pending, Role, SharedMemory,
    TrajectoryHeader, TrajectoryPublisher,
};
use protocol::config::{ActionChoice, RunConfig};
use protocol::messages::{ActorSeconds, Lease, LeaseReply, LeaseRequest};
use protocol::process::Stop;
use protocol::run::RunFolder;
use protocol::trajectory::{Encoded, Source, Trajectory};
use protocol::weights::Weights;

use crate::lane::Lane;
use crate::policy::{Policy, Version};

/// Lanes an actor keeps going at once.
const LANES_AT_ONCE: usize = 16;

/// How long an actor sleeps, and leaves a learner alone that is not there.
const ASK_AGAIN: Duration = Duration::from_millis(250);

/// How long a reader's full queue is waited for.
const READER_PATIENCE: Duration = Duration::from_secs(120);

/// A request is answered when there are leases. Asking again after this long shows the learner that
/// the actor lives, and finds a learner that was restarted.
const ANSWER_PATIENCE: Duration = Duration::from_secs(5);

/// Versions of the policy kept: with lag 1 the one before the newest still acts.
const VERSIONS_KEPT: usize = 2;

/// An actor at work.
struct Actor {
    folder: RunFolder,
    name: String,
    config: RunConfig,
    policy: Policy,
    versions: Vec<Version>,
    lanes: Vec<Lane>,
    finished: Vec<Lease>,
    pending: Option<(Pending<SharedMemory>, Instant)>,
    refused: Instant,
    over: bool,
    doorbell: Doorbell<SharedMemory>,
    leases: Client<SharedMemory>,
    weights: NewestSubscriber<SharedMemory>,
    trajectories: TrajectoryPublisher<SharedMemory>,
}

/// Acts until the run is over or a stop is requested.
pub fn rollout(folder: &RunFolder, name: &str, stop: &Stop) -> Result<()> {
    let config = folder.config()?;
    let bus = Bus::open(&BusAddress::of_run(folder.path())?, name)?;
    let mut actor = Actor {
        folder: folder.clone(),
        name: name.to_owned(),
        policy: Policy::new(&config),
        config,
        versions: Vec::new(),
        lanes: Vec::new(),
        finished: Vec::new(),
        pending: None,
        refused: Instant::now() - ASK_AGAIN,
        over: false,
        doorbell: bus.doorbell(Role::Actors)?,
        leases: bus.lease_client(Role::Actors)?,
        weights: bus.weights_subscriber()?,
        trajectories: bus.trajectory_publisher(READER_PATIENCE)?,
    };
    while !stop.is_requested() && !actor.over {
        actor.turn()?;
    }
    Ok(())
}

impl Actor {
    fn turn(&mut self) -> Result<()> {
        self.take_weights()?;
        self.take_leases()?;
        self.ask_for_leases();
        let acting = self.lanes.first().map(|lane| lane.lease.policy_version);
        let version = self.versions.iter().find(|version| Some(version.number) == acting);
        let Some(version) = version else {
            self.doorbell.wait(ASK_AGAIN)?;
            return Ok(());
        };
        let evaluates = self.lanes[0].lease.source == Source::Evaluation as i32;
        let choice = if evaluates { self.config.evaluation.actions } else { ActionChoice::Sample };
        let trajectories = self.policy.step(version, &mut self.lanes, choice)?;
        for trajectory in trajectories {
            self.publish(trajectory)?;
        }
        let finished = self.lanes.extract_if(.., |lane| lane.is_done());
        self.finished.extend(finished.map(|lane| lane.lease));
        Ok(())
    }

    fn take_weights(&mut self) -> Result<()> {
        while let Some(bytes) = self.weights.receive()? {
            let weights = Weights::decode(bytes).context("weights")?;
            let version = self.policy.version(&weights)?;
            self.versions.retain(|known| known.number != version.number);
            self.versions.push(version);
            if self.versions.len() > VERSIONS_KEPT {
                self.versions.remove(0);
            }
        }
        Ok(())
    }

    /// Asks when lanes are free, one request at a time.
    fn ask_for_leases(&mut self) {
        let free = LANES_AT_ONCE - self.lanes.len();
        if free == 0 || self.pending.is_some() || self.refused.elapsed() < ASK_AGAIN {
            return;
        }
        let request = LeaseRequest {
            actor: self.name.clone(),
            capacity: free as u32,
            finished: self.finished.clone(),
            seconds: Some(self.policy.seconds),
        };
        match self.leases.send(&request.encode_to_vec()) {
            Ok(pending) => {
                self.pending = Some((pending, Instant::now()));
                self.finished.clear();
                self.policy.seconds = ActorSeconds::default();
            }
            Err(error) => {
                tracing::debug!("no learner to ask: {error}");
                self.refused = Instant::now();
                self.over = self.folder.summary_file().exists();
            }
        }
    }

    fn take_leases(&mut self) -> Result<()> {
        let Some((pending, since)) = &self.pending else { return Ok(()) };
        match pending.poll() {
            Ok(None) if since.elapsed() < ANSWER_PATIENCE => Ok(()),
            Ok(None) | Err(_) => {
                self.pending = None;
                Ok(())
            }
            Ok(Some(bytes)) => {
                self.pending = None;
                let reply = LeaseReply::decode(bytes).context("lease reply")?;
                self.over = reply.finished;
                self.begin(&reply.leases)
            }
        }
    }

    /// Begins leases. Older ones of another rollout are dropped: nobody waits for them any more.
    fn begin(&mut self, leases: &[Lease]) -> Result<()> {
        let Some(first) = leases.first() else { return Ok(()) };
        let rollout = |lease: &Lease| (lease.source, lease.iteration);
        self.lanes.retain(|lane| rollout(&lane.lease) == rollout(first));
        for lease in leases {
            let RunConfig { task, environment, seed, .. } = &self.config;
            self.lanes.push(Lane::begin(*lease, *task, environment, *seed)?);
        }
        Ok(())
    }

    fn publish(&mut self, trajectory: Trajectory) -> Result<()> {
        let begun = Instant::now();
        let iteration = trajectory.iteration;
        let encoded = Encoded::encode(trajectory);
        let header = TrajectoryHeader {
            iteration,
            lane: encoded.key.lane,
            episode: encoded.key.episode,
            hash: encoded.key.hash,
        };
        // What a reader misses it asks for: the learner by leasing again, the service by name.
        self.trajectories.publish(&encoded.bytes, header)?;
        self.policy.seconds.transport += begun.elapsed().as_secs_f64();
        Ok(())
    }
}
