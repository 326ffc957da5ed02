//! `goalward replay --publish`: an actor publishes the recorded trajectories on the run's bus again.

use std::ops::RangeInclusive;

use anyhow::Result;
use bus::BusAddress;
use run::folder::RunFolder;
use run::holder::Work;
use serde::{Deserialize, Serialize};

use crate::full_log::FullLog;
use crate::lock::Lock;
use crate::output_format::OutputFormat;
use crate::programs::{self, Program};
use terminal::numbers;
use terminal::print::print_remark;
use terminal::refusal::wrong_usage;

/// Factors by which the recorded pace can be changed.
const SPEEDS: RangeInclusive<f64> = 1e-3..=1e6;

/// The actor's report.
#[derive(Debug, Deserialize, Serialize)]
struct Published {
    trajectories: u64,
    readers: u64,
}

/// Publishes a log once there is a subscriber; Ctrl-C ends it.
pub(super) fn publish(folder: &RunFolder, speed: Option<f64>, output: OutputFormat) -> Result<()> {
    folder.config()?;
    if let Some(speed) = speed.filter(|speed| !SPEEDS.contains(speed)) {
        let (least, most) = (SPEEDS.start(), SPEEDS.end());
        return Err(wrong_usage(format!(
            "--speed: expected a factor between {least} and {most}, found {speed}"
        )));
    }
    // With the lock held, nobody can train on this bus in the meantime.
    let _lock = Lock::take(folder, Work::Publishing)?;
    let address = BusAddress::for_start(folder.path())?;
    // Subscribers that are already there stay connected.
    if !address.is_anyone_alive()? {
        address.remove()?;
    }
    let log = FullLog::of(folder)?;
    let mut actor = Program::Actor.command()?;
    actor.arg("publish").arg("--run").arg(folder.path()).arg("--log").arg(log.folder());
    if let Some(speed) = speed {
        actor.args(["--speed", &speed.to_string()]);
    }
    print_remark(&format!("publishing {} once a subscriber is there", folder.log().display()));
    let published = programs::result_unless_stopped::<Published>(&mut actor, "publishing");
    if !address.is_anyone_alive()? {
        address.remove()?;
    }
    let published = published?;
    output.print(&published, |Published { trajectories, readers }| {
        format!("published {} trajectories; readers: {readers}", numbers::count(*trajectories))
    })
}
