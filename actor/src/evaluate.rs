//! `goalward evaluate`: a checkpoint's policy acts on evaluation seeds, and its episodes are kept.

use std::path::{Path, PathBuf};

use anyhow::Result;
use environments::Environment;
use mcap_log::{FileWriter, Topic};
use protocol::messages::Lease;
use protocol::trajectory::{Encoded, Source, Trajectory};
use protocol::weights::Weights;
use run::checkpoint;
use run::config::{ActionChoice, RunConfig};
use run::folder::{POLICY_FILE, RunFolder};
use run::headway::{Headway, Teller};
use run::metadata;
use serde::Serialize;

use crate::drawing::draw;
use crate::factory::{Factory, Tasks};
use crate::lane::Lane;
use crate::pace::LANES_AT_ONCE;
use crate::policy::Policy;

/// Number of episodes in a file, from the first, that a viewer can draw.
const DRAWN_EPISODES: usize = 20;

/// What is to be evaluated.
#[derive(Debug)]
pub(crate) struct Wanted {
    /// Episodes to run.
    pub(crate) episodes: u64,
    /// How actions are chosen; `None` for as at the end of training.
    pub(crate) actions: Option<ActionChoice>,
    /// Seed of the episodes, if it is not the run's.
    pub(crate) other_seed: Option<u64>,
    /// Iterations that the checkpoint is after; `None` for the newest.
    pub(crate) checkpoint: Option<u64>,
    /// File for the episodes; `None` for one in the run's folder.
    pub(crate) file: Option<PathBuf>,
    /// Whether a Python module of the environment may have changed since training.
    pub(crate) other_build: bool,
}

/// The result of an evaluation, as it is printed.
#[derive(Debug, Serialize)]
pub(crate) struct Evaluation {
    /// Episodes run.
    pub(crate) episodes: u64,
    /// Share of them that reached the goal; `None` if the task does not tell success.
    pub(crate) success_rate: Option<f64>,
    /// Mean of the environment's own returns.
    pub(crate) mean_return: f64,
    /// Mean length of an episode.
    pub(crate) mean_steps: f64,
    /// Updates the policy has had.
    pub(crate) policy_version: u64,
    /// File that holds the episodes.
    pub(crate) file: PathBuf,
}

/// Runs evaluation episodes with a checkpoint of a run: the same episodes, in the same lanes, that the run itself ends
/// with, and more if asked for. With another seed, the episodes are those of that seed.
///
/// # Errors
/// When there is no such intact checkpoint, an environment fails, or the file cannot be written.
pub(crate) fn evaluate(tasks: Tasks, folder: &RunFolder, wanted: Wanted) -> Result<Evaluation> {
    let Wanted { episodes, actions, other_seed, checkpoint, file, other_build } = wanted;
    let mut config = folder.config()?;
    let actions = actions.unwrap_or(config.evaluation.actions);
    config.evaluation.actions = actions;
    let weights = checkpoint::chosen(folder, checkpoint, &[POLICY_FILE])?.policy()?;
    let factory_of = if other_build { Factory::of_changed_run } else { Factory::of_run };
    let factory = factory_of(tasks, &config)?;
    let seed = other_seed.unwrap_or(config.seed);
    let trajectories = act(&factory, &config, &weights, episodes, seed)?;
    let own_file = || folder.evaluation_file(weights.version, episodes, actions, other_seed);
    let file = file.unwrap_or_else(own_file);
    record(&file, &config, &mut *factory.make()?, &trajectories)?;
    let count = trajectories.len() as f64;
    let reached = trajectories.iter().filter(|trajectory| trajectory.success).count();
    let steps: u64 = trajectories.iter().map(|trajectory| u64::from(trajectory.steps)).sum();
    let returns = trajectories.iter().map(Trajectory::environment_return);
    Ok(Evaluation {
        episodes,
        success_rate: config.task.tells_success.then_some(reached as f64 / count),
        mean_return: returns.sum::<f64>() / count,
        mean_steps: steps as f64 / count,
        policy_version: weights.version,
        file,
    })
}

/// Runs the evaluation episodes of a seed; returns them by lane, then by episode.
///
/// # Errors
/// When the weights are not this run's, or an environment fails.
pub(crate) fn act(
    factory: &Factory,
    config: &RunConfig,
    weights: &Weights,
    episodes: u64,
    seed: u64,
) -> Result<Vec<Trajectory>> {
    let mut policy = Policy::new(config);
    let version = policy.version(weights)?;
    let begin = |(lane, episodes_owed)| {
        let lease = Lease {
            source: Source::Evaluation as i32,
            iteration: weights.version,
            lane,
            policy_version: weights.version,
            first_episode: 0,
            steps_owed: 0,
            episodes_owed,
        };
        Lane::begin(lease, factory, None, seed)
    };
    let plans = (0..).zip(config.rollout.spread(episodes));
    let mut lanes = plans.map(begin).collect::<Result<Vec<_>>>()?;
    let mut trajectories: Vec<Trajectory> = Vec::new();
    let mut steps_done = 0;
    let mut teller = Teller::default();
    while !lanes.is_empty() {
        for some in lanes.chunks_mut(LANES_AT_ONCE) {
            let ended = policy.step(&version, some, config.evaluation.actions)?;
            steps_done += ended.iter().map(|trajectory| u64::from(trajectory.steps)).sum::<u64>();
            trajectories.extend(ended);
        }
        lanes.retain(|lane| !lane.is_done());
        let episodes_done = trajectories.len() as u64;
        teller.tell(Headway { episodes_done, episodes_wanted: episodes, steps_done });
    }
    trajectories.sort_by_key(|trajectory| (trajectory.lane, trajectory.episode));
    Ok(trajectories)
}

fn record(
    file: &Path,
    config: &RunConfig,
    environment: &mut dyn Environment,
    trajectories: &[Trajectory],
) -> Result<()> {
    let metadata = metadata::of_run(config);
    let topics = [Topic::EvaluationTrajectory, Topic::Scene, Topic::Picture];
    let mut writer = FileWriter::create_anew(file, &metadata, &topics)?;
    let mut time_ns = 0;
    for (number, trajectory) in trajectories.iter().enumerate() {
        writer.trajectory(&Encoded::encode(trajectory.clone()), time_ns)?;
        if number < DRAWN_EPISODES && config.task.deterministic {
            time_ns = draw(&mut writer, environment, trajectory, time_ns)?;
        }
    }
    Ok(writer.seal()?)
}
