//! `goalward replay --publish`: the trajectories of a log go onto the bus again, byte by byte in the
//! order they came, for whoever listens. No lease is asked for and nothing learns from them.

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

/// How long a reader's full queue is waited for.
const READER_PATIENCE: Duration = Duration::from_secs(120);

/// Longest sleep, so that a stop is noticed.
const TICK: Duration = Duration::from_millis(50);

/// A reader that has just come finds what waits for it only while the publisher lives.
const LINGER: Duration = Duration::from_secs(2);

/// What was published, as it is printed.
#[derive(Debug, Default, Serialize)]
pub struct Published {
    /// Trajectories.
    pub trajectories: u64,
    /// Readers there were at the end.
    pub readers: usize,
}

/// Publishes the trajectories of the run's log in `log` on the run's bus once there is a reader: at
/// `speed` times the pace they were recorded at, or as fast as readers take them.
///
/// # Errors
/// When the run has no bus, or its log cannot be read.
pub fn publish(
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

/// When something is due that was recorded so many nanoseconds after the first.
fn time_of(since_first_ns: u64, speed: f64) -> Duration {
    Duration::from_nanos(since_first_ns).div_f64(speed)
}
