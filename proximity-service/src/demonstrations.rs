//! Demonstrations: expert observations and their labels, read once from an MCAP file.
//!
//! Only observations are taken over; whatever actions a file holds stay behind here.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use protocol::config::RewardConfig;
use protocol::log::{Ending, FileReader, Record};
use protocol::seed::{self, Purpose};
use protocol::task::Spec;
use protocol::trajectory::{Encoded, Trajectory};
use rand::seq::SliceRandom;

use crate::target::demonstration_target;

/// Expert observations, one after another, and the proximity label of each.
#[derive(Clone, Debug, PartialEq)]
pub struct Demonstrations {
    /// Observations, each of the spec's length in bytes.
    pub observations: Vec<u8>,
    /// One label per observation, in [0, 1].
    pub targets: Vec<f32>,
}

/// Which demonstrations of a file are taken.
pub struct Selection {
    /// Shapes of the task.
    pub spec: Spec,
    /// How many.
    pub episodes: u64,
    /// Seed of the run: where a file has more, each seed takes its own subset.
    pub run_seed: u64,
}

impl Demonstrations {
    /// Reads the demonstrations of a file.
    pub fn load(file: &Path, selection: &Selection, config: &RewardConfig) -> Result<Self> {
        let trajectories =
            read(file, selection).with_context(|| format!("demonstrations {}", file.display()))?;
        Ok(Self::of(&trajectories, config))
    }

    /// Labels the observations of successful trajectories (Eq. 1).
    pub fn of(trajectories: &[Trajectory], config: &RewardConfig) -> Self {
        let mut demonstrations = Demonstrations { observations: Vec::new(), targets: Vec::new() };
        for trajectory in trajectories {
            demonstrations.observations.extend(trajectory.observations());
            let label = |steps_to_goal| demonstration_target(steps_to_goal, config);
            demonstrations.targets.extend((0..=trajectory.steps).rev().map(label));
        }
        demonstrations
    }

    /// Observations held.
    pub fn len(&self) -> usize {
        self.targets.len()
    }

    /// Whether none is held.
    pub fn is_empty(&self) -> bool {
        self.targets.is_empty()
    }
}

fn read(file: &Path, selection: &Selection) -> Result<Vec<Trajectory>> {
    let mut reader = FileReader::open(file)?;
    let mut trajectories = Vec::new();
    for entry in &mut reader {
        if let Record::Trajectory(bytes) = entry?.record {
            let trajectory = Encoded::decode(bytes, &selection.spec)?.trajectory;
            ensure!(trajectory.success, "episode {} does not reach the goal", trajectory.episode);
            trajectories.push(trajectory);
        }
    }
    let ending = reader.ending();
    ensure!(matches!(ending, Some(Ending::Complete)), "the file is damaged: {ending:?}");
    let (found, wanted) = (trajectories.len(), selection.episodes as usize);
    ensure!(found >= wanted, "expected at least {wanted} episodes, found {found}");
    let mut chosen: Vec<usize> = (0..found).collect();
    chosen.shuffle(&mut seed::stream(selection.run_seed, Purpose::DemonstrationSubset, 0, 0));
    chosen.truncate(wanted);
    chosen.sort_unstable();
    Ok(chosen.into_iter().map(|position| trajectories[position].clone()).collect())
}
