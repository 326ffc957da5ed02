//! The evaluation episodes of a run for which its proximity function is queried.

use std::fs;
use std::path::PathBuf;

use anyhow::{Context, Result};
use mcap_log::{FileReader, Record};
use protocol::scene::SceneUpdate;
use protocol::trajectory::Trajectory;
use run::checkpoint;
use run::config::{RewardConfig, RewardInput, RunConfig};
use run::folder::{POLICY_FILE, RunFolder};

use crate::programs::ReportPrograms;

/// Number of episodes read, from the first of a file. Later ones have no scenes.
const EPISODES: usize = 20;

/// An evaluation episode.
pub(crate) struct Episode {
    /// The trajectory.
    pub(crate) trajectory: Trajectory,
    /// The scene at each of its observations; empty if the task has no solids or cannot be re-simulated.
    pub(crate) scenes: Vec<SceneUpdate>,
}

/// Returns whether a run learned a proximity function of single states.
pub(crate) fn has_proximity(config: &RunConfig) -> bool {
    let RewardConfig { model, input, .. } = &config.reward;
    model.imitates && !model.is_discriminator() && *input == RewardInput::State
}

/// Reads evaluation episodes of the run's newest policy. If it has not been evaluated, the evaluation is run now, and
/// its file stays in the run's folder.
///
/// # Errors
/// When the evaluation cannot be run, or its file cannot be read.
pub(crate) fn episodes(
    folder: &RunFolder,
    config: &RunConfig,
    programs: &dyn ReportPrograms,
) -> Result<Vec<Episode>> {
    let file = match evaluated(folder)? {
        Some(file) => file,
        None => programs.evaluate(folder, EPISODES)?,
    };
    let mut episodes: Vec<Episode> = Vec::new();
    for entry in FileReader::open(&file)? {
        match entry?.record {
            Record::EvaluationTrajectory(_) if episodes.len() == EPISODES => break,
            Record::EvaluationTrajectory(bytes) => {
                let trajectory = Trajectory::recorded(bytes, &config.task.spec())
                    .with_context(|| file.display().to_string())?;
                episodes.push(Episode { trajectory, scenes: Vec::new() });
            }
            Record::Scene(scene) => {
                if let Some(episode) = episodes.last_mut() {
                    episode.scenes.push(scene);
                }
            }
            _ => {}
        }
    }
    Ok(episodes)
}

/// Returns the file of the newest policy's evaluation that has the most episodes.
fn evaluated(folder: &RunFolder) -> Result<Option<PathBuf>> {
    let Some(newest) = checkpoint::newest(folder, &[POLICY_FILE])?.newest else { return Ok(None) };
    let shown = || folder.path().display().to_string();
    let mut found = Vec::new();
    for entry in fs::read_dir(folder.path()).with_context(shown)? {
        let path = entry.with_context(shown)?.path();
        let numbers = path.file_name().and_then(|name| evaluation_numbers(name.to_str()?));
        let of_newest = numbers.filter(|(version, _)| *version == newest.iteration);
        found.extend(of_newest.map(|(_, episodes)| (episodes, path)));
    }
    Ok(found.into_iter().max().map(|(_, path)| path))
}

/// Returns the policy version and number of episodes from a file name such as `evaluation-v000367-200-sample.mcap`.
fn evaluation_numbers(name: &str) -> Option<(u64, u64)> {
    let numbers = name.strip_prefix("evaluation-v")?.strip_suffix(".mcap")?;
    let (version, rest) = numbers.split_once('-')?;
    let (episodes, _actions) = rest.split_once('-')?;
    Some((version.parse().ok()?, episodes.parse().ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn evaluations_are_known_by_their_names() {
        assert_eq!(evaluation_numbers("evaluation-v000367-200-mode.mcap"), Some((367, 200)));
        assert_eq!(evaluation_numbers("evaluation-v000367-200-mode.csv"), None);
        assert_eq!(evaluation_numbers("demonstrations.mcap"), None);
    }
}
