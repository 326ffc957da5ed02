//! An actor's ports: leases from the learner, and trajectories to their readers.

use std::time::{Duration, Instant};

use anyhow::{Result, bail, ensure};
use bus::{Bus, BusAddress, Doorbell, LeaseAsker, Role, TrajectoryHeader, TrajectoryPublisher};
use bytes::Bytes;
use prost::Message;
use protocol::dropped::Dropped;
use protocol::messages::{ActorSeconds, Lease, LeaseReply, LeaseRequest};
use protocol::trajectory::{Encoded, Source};
use run::folder::RunFolder;
use run::process::Stop;
use run::process_stat::ProcessorClock;

/// Longest sleep of an actor.
const TICK: Duration = Duration::from_millis(250);

/// How long to wait for the learner or the service while its queue is full. They read at least once a second,
/// unless they are suspended or in a long computation, and they ask for what they miss.
const READER_PATIENCE: Duration = Duration::from_secs(2);

/// How long an actor that was started by hand looks for a learner; a dead learner is restarted sooner than this.
const LEARNER_PATIENCE: Duration = Duration::from_secs(30);

/// The ports of an actor, wherever its trajectories come from.
pub(crate) struct Ports {
    folder: RunFolder,
    name: String,
    finished: Vec<Lease>,
    joined: bool,
    /// Since when there has been no learner to ask.
    alone: Option<Instant>,
    over: bool,
    stop: Stop,
    dropped: Dropped,
    clock: ProcessorClock,
    doorbell: Doorbell,
    leases: LeaseAsker,
    trajectories: TrajectoryPublisher,
}

impl Ports {
    /// Opens the ports of the actor `name`; also returns the bus they are on.
    ///
    /// # Errors
    /// When the run has not been started.
    pub(crate) fn open(folder: &RunFolder, name: &str, stop: &Stop) -> Result<(Ports, Bus)> {
        // An actor restarted under the same name counts as another one: its predecessor's leases are open again
        // as soon as the predecessor is known to be dead.
        let name = format!("{name}-{}", std::process::id());
        let bus = Bus::open(&BusAddress::of_run(folder.path())?, &name)?;
        let doorbell = bus.doorbell(Role::Actors)?;
        let ports = Ports {
            folder: folder.clone(),
            name,
            finished: Vec::new(),
            joined: false,
            alone: None,
            over: false,
            stop: stop.clone(),
            dropped: Dropped::new("answers about leases"),
            clock: ProcessorClock::default(),
            leases: bus.lease_asker(&doorbell)?,
            doorbell,
            trajectories: bus.rollout_publisher(READER_PATIENCE)?,
        };
        Ok((ports, bus))
    }

    /// Returns whether there is nothing more to do: the run is over, or a stop was requested. An actor without
    /// a supervisor also leaves a run that has lost its learner for good.
    ///
    /// # Errors
    /// When the actor has no supervisor and has found no learner at all.
    pub(crate) fn is_over(&self) -> Result<bool> {
        let gave_up = self.alone.is_some_and(|since| since.elapsed() >= LEARNER_PATIENCE);
        if !gave_up || self.stop.is_held() {
            return Ok(self.over || self.stop.is_requested());
        }
        let (run, seconds) = (self.folder.path().display(), LEARNER_PATIENCE.as_secs());
        if self.joined {
            tracing::info!("the run in {run} has had no learner for {seconds} s: leaving it");
            return Ok(true);
        }
        bail!("expected a run that trains in {run}, found no learner for {seconds} s")
    }

    /// Sleeps until something arrives, for a quarter of a second at most.
    ///
    /// # Errors
    /// When the bus fails.
    pub(crate) fn wait(&mut self) -> Result<()> {
        self.doorbell.wait(TICK)?;
        Ok(())
    }

    /// Notes a lease to hand back with the next request: everything of it is published, or it is given up.
    pub(crate) fn finish(&mut self, lease: Lease) {
        self.finished.push(lease);
    }

    /// Asks for leases, one request at a time; `seconds` is sent along and reset.
    pub(crate) fn ask(&mut self, capacity: usize, seconds: &mut ActorSeconds) {
        if capacity == 0 || !self.leases.is_free() {
            return;
        }
        seconds.processor += self.clock.lap();
        let request = LeaseRequest {
            actor: self.name.clone(),
            capacity: capacity as u32,
            finished: self.finished.clone(),
            seconds: Some(*seconds),
        };
        match self.leases.ask(&request.encode_to_vec()) {
            Ok(()) => {
                if !std::mem::replace(&mut self.joined, true) {
                    tracing::info!("joined the run in {}", self.folder.path().display());
                }
                self.alone = None;
                self.finished.clear();
                *seconds = ActorSeconds::default();
            }
            Err(error) => {
                tracing::debug!("no learner to ask: {error}");
                self.alone.get_or_insert_with(Instant::now);
                self.over = self.folder.summary_file().exists();
            }
        }
    }

    /// Returns the leases granted since the last call.
    pub(crate) fn granted(&mut self) -> Vec<Lease> {
        let dropped = &mut self.dropped;
        let read = |bytes| granted(bytes).map_err(|why| dropped.note(why)).ok();
        let Some(reply) = self.leases.answer(read) else { return Vec::new() };
        self.over = reply.finished;
        reply.leases
    }

    /// Publishes a trajectory; readers wake at [`Self::ring`]. Readers recover what they miss: the learner
    /// grants the lease again, the service asks for the trajectory by name.
    ///
    /// # Errors
    /// When the bus fails.
    pub(crate) fn publish(&mut self, encoded: &Encoded) -> Result<()> {
        self.trajectories.send(&encoded.bytes, TrajectoryHeader::from(encoded))?;
        Ok(())
    }

    /// Wakes the readers of trajectories.
    ///
    /// # Errors
    /// When the bus fails.
    pub(crate) fn ring(&mut self) -> Result<()> {
        Ok(self.trajectories.ring()?)
    }
}

/// Reads a reply. The learner replies when there are leases, or when the run is over.
fn granted(bytes: Bytes) -> Result<LeaseReply> {
    let reply = LeaseReply::decode(bytes)?;
    ensure!(reply.finished || !reply.leases.is_empty(), "expected leases, found none");
    for lease in &reply.leases {
        let most_episodes = lease.steps_owed.max(lease.episodes_owed);
        let is_countable = lease.first_episode.checked_add(most_episodes).is_some();
        ensure!(
            Source::try_from(lease.source).is_ok() && most_episodes > 0 && is_countable,
            "expected a lease that can be run, found {lease:?}"
        );
    }
    Ok(reply)
}
