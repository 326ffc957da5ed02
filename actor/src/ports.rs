//! An actor's ports: leases from the learner, and trajectories to whoever reads them.

use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use prost::Message;
use protocol::bus::{
    Bus, BusAddress, Client, Doorbell, Pending, Role, SharedMemory, TrajectoryHeader,
    TrajectoryPublisher,
};
use protocol::messages::{ActorSeconds, Lease, LeaseReply, LeaseRequest};
use protocol::run::RunFolder;
use protocol::trajectory::Encoded;

/// How long an actor sleeps, and leaves a learner alone that is not there.
const ASK_AGAIN: Duration = Duration::from_millis(250);

/// How long a reader's full queue is waited for.
pub const READER_PATIENCE: Duration = Duration::from_secs(120);

/// A request is answered when there are leases. Asking again after this long shows the learner that
/// the actor lives, and finds a learner that was restarted.
const ANSWER_PATIENCE: Duration = Duration::from_secs(5);

/// The ports of an actor, whatever its trajectories come from.
pub struct Ports {
    folder: RunFolder,
    name: String,
    finished: Vec<Lease>,
    pending: Option<(Pending<SharedMemory>, Instant)>,
    refused: Instant,
    over: bool,
    doorbell: Doorbell<SharedMemory>,
    leases: Client<SharedMemory>,
    trajectories: TrajectoryPublisher<SharedMemory>,
}

impl Ports {
    /// Opens the ports of an actor of this name; also returns the bus they are on.
    pub fn open(folder: &RunFolder, name: &str) -> Result<(Ports, Bus)> {
        // One that is started again under the same name is another actor: its predecessor's leases are
        // open again as soon as that is known to be dead.
        let name = format!("{name}-{}", std::process::id());
        let bus = Bus::open(&BusAddress::of_run(folder.path())?, &name)?;
        let ports = Ports {
            folder: folder.clone(),
            name,
            finished: Vec::new(),
            pending: None,
            refused: Instant::now() - ASK_AGAIN,
            over: false,
            doorbell: bus.doorbell(Role::Actors)?,
            leases: bus.lease_client(Role::Actors)?,
            trajectories: bus.trajectory_publisher(READER_PATIENCE)?,
        };
        Ok((ports, bus))
    }

    /// Whether the run is over.
    pub fn is_over(&self) -> bool {
        self.over
    }

    /// Sleeps until something comes.
    pub fn wait(&mut self) -> Result<()> {
        self.doorbell.wait(ASK_AGAIN)?;
        Ok(())
    }

    /// Says at the next question that everything of a lease is published.
    pub fn finish(&mut self, lease: Lease) {
        self.finished.push(lease);
    }

    /// Asks for leases, one request at a time; `seconds` is told and begins anew.
    pub fn ask(&mut self, capacity: usize, seconds: &mut ActorSeconds) {
        if capacity == 0 || self.pending.is_some() || self.refused.elapsed() < ASK_AGAIN {
            return;
        }
        let request = LeaseRequest {
            actor: self.name.clone(),
            capacity: capacity as u32,
            finished: self.finished.clone(),
            seconds: Some(*seconds),
        };
        match self.leases.send(&request.encode_to_vec()) {
            Ok(pending) => {
                self.pending = Some((pending, Instant::now()));
                self.finished.clear();
                *seconds = ActorSeconds::default();
            }
            Err(error) => {
                tracing::debug!("no learner to ask: {error}");
                self.refused = Instant::now();
                self.over = self.folder.summary_file().exists();
            }
        }
    }

    /// The leases that were granted since the last look.
    pub fn granted(&mut self) -> Result<Vec<Lease>> {
        let Some((pending, since)) = &self.pending else { return Ok(Vec::new()) };
        match pending.poll() {
            Ok(None) if since.elapsed() < ANSWER_PATIENCE => Ok(Vec::new()),
            Ok(None) | Err(_) => {
                self.pending = None;
                Ok(Vec::new())
            }
            Ok(Some(bytes)) => {
                self.pending = None;
                let reply = LeaseReply::decode(bytes).context("lease reply")?;
                self.over = reply.finished;
                Ok(reply.leases)
            }
        }
    }

    /// Publishes a trajectory. What a reader misses it asks for: the learner by leasing again, the
    /// service by name.
    pub fn publish(&mut self, encoded: &Encoded) -> Result<()> {
        self.trajectories.publish(&encoded.bytes, header(encoded))?;
        Ok(())
    }
}

/// What a reader sees of a trajectory before it decodes it.
pub fn header(encoded: &Encoded) -> TrajectoryHeader {
    TrajectoryHeader {
        iteration: encoded.trajectory.iteration,
        lane: encoded.key.lane,
        episode: encoded.key.episode,
        hash: encoded.key.hash,
    }
}
