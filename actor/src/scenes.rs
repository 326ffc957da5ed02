//! `goalward-actor scenes`: recorded episodes are re-simulated and written with what a viewer draws of them.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use bytes::Bytes;
use environments::Setting;
use mcap_log::{FileWriter, Topic};
use prost::bytes::Buf;
use protocol::scene::FRAME_NS;
use protocol::trajectory::{Encoded, Trajectory};
use run::folder::RunFolder;
use run::metadata;
use serde::Serialize;

use crate::drawing::draw;
use crate::factory::{Factory, Tasks};
use crate::resimulate::Resimulator;

/// The result, as it is printed.
#[derive(Debug, Serialize)]
pub(crate) struct Written {
    /// Episodes written.
    pub(crate) episodes: u64,
    /// Frames of all episodes together; 0 if there is nothing to draw: no solids and no pictures.
    pub(crate) frames: u64,
}

/// Re-simulates episodes of a run, which are length-delimited in `recorded`, and writes them with their
/// observations to a new file. `setting` is the setting of their environment if it is not the run's. With
/// `pictures`, a Python environment renders pictures, if it can.
///
/// # Errors
/// When an episode does not come out as it was recorded, or the file cannot be written.
pub(crate) fn write(
    tasks: Tasks,
    folder: &RunFolder,
    setting: Option<Setting>,
    pictures: bool,
    recorded: Bytes,
    out: &Path,
) -> Result<Written> {
    let config = folder.config()?;
    let factory = Factory::for_resimulation(tasks, &config)?;
    let factory = setting.map_or(factory.clone(), |setting| factory.with_setting(setting));
    let threads = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    let mut resimulator = Resimulator::new(&threads, &factory)?;
    let episodes = episodes(recorded)?;
    let acted = resimulator.each(&episodes, |_, acted| acted);
    let mut environment = if pictures { factory.rendering()? } else { factory.make()? };
    let topics = [Topic::Trajectory, Topic::EvaluationTrajectory, Topic::Scene, Topic::Picture];
    let mut writer = FileWriter::create_anew(out, &metadata::of_run(&config), &topics)?;
    let mut time_ns = 0;
    for (recorded, acted) in episodes.iter().zip(acted) {
        let trajectory = acted?;
        let Trajectory { lane, episode, state_hash, .. } = *recorded;
        let found = trajectory.state_hash;
        ensure!(
            found == state_hash,
            "lane {lane} episode {episode}: expected the recorded state {state_hash:016x}, found {found:016x}"
        );
        writer.trajectory(&Encoded::encode(trajectory), time_ns)?;
        time_ns = draw(&mut writer, &mut *environment, recorded, time_ns)?;
    }
    writer.seal()?;
    Ok(Written { episodes: episodes.len() as u64, frames: time_ns / FRAME_NS })
}

fn episodes(mut recorded: Bytes) -> Result<Vec<Trajectory>> {
    let mut episodes = Vec::new();
    while recorded.has_remaining() {
        let episode = prost::Message::decode_length_delimited(&mut recorded);
        episodes.push(episode.context("reading episodes")?);
    }
    Ok(episodes)
}
