//! `goalward replay --publish`: the trajectories of a log go onto the bus again, byte for byte and in the order
//! they arrived, for any reader. No lease is requested, and nothing learns from them.

use std::path::Path;
use std::thread;
use std::time::{Duration, Instant};

use anyhow::Result;
use bus::{Bus, BusAddress, TrajectoryHeader};
use mcap_log::{Contents, read_contents};
use protocol::trajectory::Encoded;
use run::folder::RunFolder;
use run::process::Stop;
use serde::Serialize;

/// How long to wait for a reader whose queue is full.
const READER_PATIENCE: Duration = Duration::from_secs(120);

/// Longest sleep, so that a stop is noticed.
const TICK: Duration = Duration::from_millis(50);

/// How long to stay after the last trajectory: a new reader gets what is queued for it only while the publisher lives.
const LINGER: Duration = Duration::from_secs(2);

/// The result of publishing, as it is printed.
#[derive(Debug, Default, Serialize)]
pub(crate) struct Published {
    /// Trajectories published.
    pub(crate) trajectories: u64,
    /// Number of readers at the end.
    pub(crate) readers: usize,
}

/// Publishes the trajectories of the log in `log` on the run's bus once there is a reader: at `speed` times the
/// pace at which they were recorded, or else as fast as readers take them.
///
/// # Errors
/// When the run has no bus, or its log cannot be read.
pub(crate) fn publish(
    folder: &RunFolder,
    log: &Path,
    speed: Option<f64>,
    stop: &Stop,
) -> Result<Published> {
    let spec = folder.config()?.task.spec();
    let bus: Bus = Bus::open(&BusAddress::of_run(folder.path())?, "replay")?;
    let publisher = bus.trajectory_publisher(READER_PATIENCE)?;
    while publisher.reader_count() == 0 && !stop.is_requested() {
        thread::sleep(TICK);
    }
    let begun = Instant::now();
    let mut first_ns = None;
    let mut published = Published::default();
    for entry in read_contents(log, Contents::Trajectories)? {
        let entry = entry?;
        let log_time_ns = entry.log_time_ns;
        let Some(bytes) = entry.record.trajectory() else { continue };
        let since_first = log_time_ns.saturating_sub(*first_ns.get_or_insert(log_time_ns));
        let due = speed.map_or(Duration::ZERO, |speed| time_of(since_first, speed));
        while begun.elapsed() < due && !stop.is_requested() {
            thread::sleep(TICK.min(due.saturating_sub(begun.elapsed())));
        }
        if stop.is_requested() {
            break;
        }
        let encoded = Encoded::decode(bytes, &spec)?;
        publisher.publish(&encoded.bytes, TrajectoryHeader::from(&encoded))?;
        published.trajectories += 1;
    }
    let ended = Instant::now();
    while ended.elapsed() < LINGER && !stop.is_requested() {
        thread::sleep(TICK);
    }
    published.readers = publisher.reader_count();
    Ok(published)
}

/// Returns when a trajectory is due that was recorded `since_first_ns` nanoseconds after the first.
fn time_of(since_first_ns: u64, speed: f64) -> Duration {
    Duration::from_nanos(since_first_ns).div_f64(speed)
}
