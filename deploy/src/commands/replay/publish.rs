//! `goalward replay --publish`: an actor publishes the recorded trajectories on the run's bus again.

use anyhow::Result;
use bus::BusAddress;
use run::folder::RunFolder;
use serde::{Deserialize, Serialize};

use crate::figures::Figures;
use crate::full_log::FullLog;
use crate::plan;
use crate::programs::{self, Program};
use terminal::numbers;
use terminal::print::print_remark;
use terminal::refusal::wrong_usage;

/// The actor's report.
#[derive(Debug, Deserialize, Serialize)]
struct Published {
    trajectories: u64,
    readers: u64,
}

/// Publishes a log once there is a subscriber; Ctrl-C ends it.
pub(super) fn publish(folder: &RunFolder, speed: Option<f64>, figures: Figures) -> Result<()> {
    folder.config()?;
    if let Some(speed) = speed.filter(|speed| !(speed.is_finite() && *speed > 0.0)) {
        return Err(wrong_usage(format!("--speed: expected a number above 0, found {speed}")));
    }
    // With the lock held, nobody can train on this bus in the meantime.
    let _lock = plan::lock(folder)?;
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
    figures.print(&published, |Published { trajectories, readers }| {
        format!("published {} trajectories; readers: {readers}", numbers::count(*trajectories))
    })
}
