//! `goalward-actor replay`: an actor that takes its trajectories from the log of a run. It takes leases like any other
//! actor and publishes the trajectories that were recorded for them, byte for byte; no environment is involved.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Result, ensure};
use mcap_log::{Contents, RunReader, read_contents};
use protocol::messages::{ActorSeconds, Lease};
use protocol::task::Spec;
use protocol::trajectory::Encoded;
use run::folder::RunFolder;
use run::process::Stop;

use crate::ports::Ports;

/// Maximum number of leases requested at once.
const LEASES_AT_ONCE: usize = 16;

/// The recording to replay.
pub(crate) struct Recording {
    /// Folder of the log.
    pub(crate) log: PathBuf,
    /// Iterations to replay; `None` replays the whole log.
    pub(crate) iterations: Option<u64>,
}

/// Publishes the recorded trajectories of the leases it is granted, until the run is over, a stop is requested,
/// or a lease is of a later iteration than wanted, or not completely in the log.
///
/// # Errors
/// When the log cannot be read, or has another policy version than a lease, or the bus fails.
pub(crate) fn replay(
    folder: &RunFolder,
    name: &str,
    recording: &Recording,
    stop: &Stop,
) -> Result<()> {
    let spec = folder.config()?.task.spec();
    let mut log = RecordedLog::open(&recording.log, spec)?;
    let (mut ports, _bus) = Ports::open(folder, name, stop)?;
    while !ports.is_over()? {
        let leases = ports.granted();
        for lease in &leases {
            let wanted = recording.iterations.is_none_or(|count| lease.iteration < count);
            let recorded = if wanted { log.of_lease(lease)? } else { None };
            let Some(trajectories) = recorded else {
                tracing::info!("the log ends in iteration {}", lease.iteration);
                return Ok(());
            };
            for encoded in trajectories {
                ports.publish(encoded)?;
            }
            ports.finish(*lease);
            ports.ring()?;
        }
        ports.ask(LEASES_AT_ONCE, &mut ActorSeconds::default());
        if leases.is_empty() {
            ports.wait()?;
        }
    }
    Ok(())
}

/// Source, iteration and lane.
type LaneName = (i32, u64, u64);

/// A log that is read only as far as leases require.
struct RecordedLog {
    log: PathBuf,
    spec: Spec,
    reader: RunReader,
    /// Trajectories that were read and may still be asked for, by episode.
    lanes: BTreeMap<LaneName, BTreeMap<u64, Encoded>>,
    /// First iteration whose trajectories are kept.
    kept_from: u64,
}

impl RecordedLog {
    fn open(log: &Path, spec: Spec) -> Result<RecordedLog> {
        let reader = read_contents(log, Contents::Trajectories)?;
        Ok(RecordedLog { log: log.to_owned(), spec, reader, lanes: BTreeMap::new(), kept_from: 0 })
    }

    /// Returns the trajectories of a lease, in order; `None` if the log does not have all of them.
    fn of_lease(&mut self, lease: &Lease) -> Result<Option<Vec<&Encoded>>> {
        if lease.iteration < self.kept_from {
            // The learner went back to a checkpoint.
            *self = RecordedLog::open(&self.log, self.spec)?;
        }
        while owed(&self.lanes, lease).is_none() {
            let Some(entry) = self.reader.next() else { return Ok(None) };
            let Some(bytes) = entry?.record.trajectory() else { continue };
            let encoded = Encoded::decode(bytes, &self.spec)?;
            let trajectory = &encoded.trajectory;
            let lane = (trajectory.source, trajectory.iteration, trajectory.lane);
            self.lanes.entry(lane).or_default().insert(trajectory.episode, encoded);
        }
        // One iteration more than needed is kept.
        self.kept_from = self.kept_from.max(lease.iteration.saturating_sub(1));
        self.lanes.retain(|(_, iteration, _), _| *iteration >= self.kept_from);
        let trajectories = owed(&self.lanes, lease).unwrap_or_default();
        for encoded in &trajectories {
            let (expected, found) = (lease.policy_version, encoded.trajectory.policy_version);
            ensure!(
                expected == found,
                "lane {} episode {}: expected policy version {expected}, found {found} in the log",
                lease.lane,
                encoded.key.episode
            );
        }
        Ok(Some(trajectories))
    }
}

/// Returns the trajectories that a lease owes, if all of them are there.
fn owed<'a>(
    lanes: &'a BTreeMap<LaneName, BTreeMap<u64, Encoded>>,
    lease: &Lease,
) -> Option<Vec<&'a Encoded>> {
    let lane = lanes.get(&(lease.source, lease.iteration, lease.lane))?;
    let (mut steps, mut trajectories) = (0, Vec::new());
    for episode in lease.first_episode.. {
        if steps >= lease.steps_owed && trajectories.len() as u64 >= lease.episodes_owed {
            break;
        }
        let encoded = lane.get(&episode)?;
        steps += u64::from(encoded.trajectory.steps);
        trajectories.push(encoded);
    }
    Some(trajectories)
}
