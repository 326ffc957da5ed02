//! `goalward demonstrate`: an expert acts and its trajectories become a demonstrations file.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use environments::Setting;
use protocol::log::{FileWriter, Kind, Metadata, Topic};
use protocol::task::Task;
use protocol::trajectory::{Encoded, Source, Trajectory};

use crate::episode::{Episode, EpisodeName};

/// What is to be recorded.
pub struct Request<'a> {
    /// The task.
    pub task: Task,
    /// How many episodes.
    pub episodes: u64,
    /// The starts and goals they may have.
    pub setting: Setting,
    /// Seed of the starts.
    pub seed: u64,
    /// The file to write; it must not exist.
    pub file: &'a Path,
}

/// Records demonstrations; returns the transitions they have together.
pub fn demonstrate(request: &Request<'_>) -> Result<u64> {
    let Request { task, episodes, setting, seed, file } = request;
    let metadata = Metadata::new(Kind::Demonstrations, task.name(), *seed)
        .with("episodes", episodes)
        .with("coverage", setting.coverage);
    let mut writer = FileWriter::create(file, &metadata, &[Topic::Trajectory])?;
    let mut steps = 0;
    for number in 0..*episodes {
        let trajectory = demonstration(*task, setting, *seed, number)?;
        ensure!(trajectory.success, "demonstration {number}: the expert did not reach the goal");
        steps += u64::from(trajectory.steps);
        // The log time counts episodes: demonstrations of one seed are the same file every time.
        writer.trajectory(&Encoded::encode(trajectory), number)?;
    }
    writer.seal()?;
    Ok(steps)
}

fn demonstration(task: Task, setting: &Setting, seed: u64, number: u64) -> Result<Trajectory> {
    let name = EpisodeName {
        source: Source::Demonstration,
        iteration: 0,
        lane: 0,
        episode: number,
        policy_version: 0,
        run_seed: seed,
    };
    let mut episode = Episode::begin(environments::create(task, setting)?, name)?;
    let mut action = vec![0; task.spec().action.bytes()];
    loop {
        ensure!(episode.expert_action(&mut action), "{task} has no scripted expert");
        let step = episode.step(&action, None).context("demonstration")?;
        if let Some(trajectory) = step {
            return Ok(trajectory);
        }
    }
}
