//! The demonstrations of a run, read from their MCAP file by whoever learns from them.

use std::path::{Path, PathBuf};

use bytes::Bytes;
use mcap_log::{Ending, FileReader, Kind, Record};
use protocol::Error;
use protocol::ending::Ending as TrajectoryEnding;
use protocol::seed::{self, Purpose};
use protocol::setting::Setting;
use protocol::task::{Spec, Task, floats};
use protocol::trajectory::{Encoded, Trajectory};
use protocol::weights::to_bytes;
use rand::seq::SliceRandom;

use crate::config::{RewardConfig, RewardModel, RunConfig, set_by_user};
use crate::folder::RunFolder;

/// What demonstrations may take of memory: hundreds of times what the paper has.
const MOST_BYTES: usize = 1 << 30;

/// The demonstrations a run learns from: [`of_file`], of its own file or of the one it was given.
///
/// # Errors
/// As [`of_file`].
pub fn load(folder: &RunFolder, config: &RunConfig) -> Result<Vec<Trajectory>, Error> {
    of_file(&file_of(folder, config), config)
}

/// The file that a run learns from: the one it was given, or its own, which may not be there yet.
pub fn file_of(folder: &RunFolder, config: &RunConfig) -> PathBuf {
    let own = || folder.demonstrations_file();
    config.demonstrations.file.clone().unwrap_or_else(own)
}

/// What a run of this configuration learns from of a file: as many demonstrations as it asks for, and
/// where the file has more, each seed takes its own subset. Each ends where it first reached the goal.
/// Actions are in the measure of the run's own action scale.
///
/// # Errors
/// [`Error::Demonstrations`] if the file is damaged, is of another task or setting, has too few, lacks
/// actions that the method needs, or does not say where a goal was reached.
pub fn of_file(file: &Path, config: &RunConfig) -> Result<Vec<Trajectory>, Error> {
    let mut reader = open(file, config.task)?;
    let recorded = setting(&reader, file, config.task)?;
    if let Some(recorded) = &recorded {
        require_setting(recorded, config, file)?;
    }
    let with_actions = config.needs_expert_actions();
    let mut trajectories = rest(&mut reader, file, &config.task.spec(), with_actions)?;
    let (found, wanted) = (trajectories.len(), config.demonstrations.episodes as usize);
    if found < wanted {
        let message = format!(
            "expected at least {wanted} demonstrations, found {found} (fewer are asked for with \
             --set demonstrations.episodes={found})"
        );
        return Err(failed(file, message));
    }
    let mut chosen: Vec<usize> = (0..found).collect();
    chosen.shuffle(&mut seed::stream(config.seed, Purpose::DemonstrationSubset, 0, 0));
    chosen.truncate(wanted);
    chosen.sort_unstable();
    let factors =
        factors(&recorded.unwrap_or_default().action_scale, &config.environment.action_scale);
    let taken = |at: usize| rescaled(std::mem::take(&mut trajectories[at]), &factors);
    let chosen: Vec<Trajectory> = chosen.into_iter().map(taken).collect();
    require_rows(&chosen, config, file)?;
    Ok(chosen)
}

/// A configuration with the coverage and noise that its file of demonstrations was recorded with,
/// where `settings`, the user's own words, name none. A file that does not tell counts as one of
/// the whole task.
///
/// # Errors
/// [`Error::Demonstrations`] if the file cannot be read, or is of another task.
pub fn adopt(mut config: RunConfig, settings: &[String]) -> Result<RunConfig, Error> {
    if let Some(file) = &config.demonstrations.file {
        let task = config.task;
        let recorded = setting(&open(file, task)?, file, task)?.unwrap_or_default();
        let named = set_by_user(settings)?;
        if !named.contains_key("demonstrations.coverage") {
            config.demonstrations.coverage = recorded.coverage;
        }
        if !named.contains_key("demonstrations.noise") {
            config.demonstrations.noise = recorded.effective_noise(task);
        }
    }
    Ok(config)
}

/// Whether a file says what its demonstrations were recorded in: which starts and goals, which
/// scale of actions.
///
/// # Errors
/// As [`adopt`].
pub fn tells_setting(file: &Path, task: Task) -> Result<bool, Error> {
    Ok(setting(&open(file, task)?, file, task)?.is_some())
}

/// Opens a file that has to hold demonstrations of a task.
fn open(file: &Path, task: Task) -> Result<FileReader, Error> {
    let reader = FileReader::open(file)?;
    let metadata = reader.metadata();
    if metadata.kind != Kind::Demonstrations {
        return Err(failed(file, "expected demonstrations, found the log of a run".to_owned()));
    }
    match metadata.get("task").unwrap_or("none") {
        found if found == task.name() => Ok(reader),
        found => {
            Err(failed(file, format!("expected demonstrations of the task {task}, found {found}")))
        }
    }
}

/// The setting that demonstrations were recorded in, if their file tells it.
fn setting(reader: &FileReader, file: &Path, task: Task) -> Result<Option<Setting>, Error> {
    let Some(text) = reader.metadata().get("setting") else { return Ok(None) };
    let unreadable = |error: String| failed(file, format!("setting {text}: {error}"));
    let setting: Setting =
        serde_json::from_str(text).map_err(|error| unreadable(error.to_string()))?;
    setting.check("setting", &task.spec()).map_err(|error| unreadable(error.to_string()))?;
    Ok(Some(setting))
}

/// Refuses demonstrations that were recorded in another setting than the configuration says.
fn require_setting(recorded: &Setting, config: &RunConfig, file: &Path) -> Result<(), Error> {
    let own = config.demonstration_setting();
    let shown = |noise: Option<f64>| noise.map_or("none".to_owned(), |noise| noise.to_string());
    let forces = |setting: &Setting| setting.contact_forces.unwrap_or(false);
    let [own_noise, noise] = [&own, recorded].map(|setting| setting.effective_noise(config.task));
    for (key, expected, found, differs) in [
        (
            "demonstrations.coverage",
            own.coverage.to_string(),
            recorded.coverage.to_string(),
            own.coverage != recorded.coverage,
        ),
        ("demonstrations.noise", shown(own_noise), shown(noise), own_noise != noise),
        (
            "environment.contact_forces",
            forces(&own).to_string(),
            forces(recorded).to_string(),
            forces(&own) != forces(recorded),
        ),
    ] {
        if differs {
            let message = format!("expected {key} = {expected}, found them recorded with {found}");
            return Err(failed(file, message));
        }
    }
    Ok(())
}

/// Refuses demonstrations that do not make a single batch of a reward model.
fn require_rows(
    demonstrations: &[Trajectory],
    config: &RunConfig,
    file: &Path,
) -> Result<(), Error> {
    let RewardConfig { model, batch, .. } = config.reward;
    // A discriminator has a row for each step, the others one for each observation.
    let last = u64::from(model != RewardModel::Discriminator);
    let rows = demonstrations.iter().map(|trajectory| u64::from(trajectory.steps) + last);
    let (rows, count) = (rows.sum::<u64>(), demonstrations.len());
    if model.learns() && rows < batch as u64 {
        let message = format!(
            "expected rows for a batch, reward.batch = {batch}, found {rows} in {count} \
             demonstrations"
        );
        return Err(failed(file, message));
    }
    Ok(())
}

/// A demonstration up to where it first reached the goal: what came after would have labels as if it
/// were closer.
fn up_to_goal(trajectory: Trajectory, spec: &Spec) -> Result<Trajectory, String> {
    let Trajectory { steps, steps_to_goal, ending, .. } = trajectory;
    match steps_to_goal {
        0 if ending == TrajectoryEnding::Terminated as i32 => Ok(trajectory),
        0 => Err("expected the step that reached the goal, or an end there, found neither".into()),
        goal if goal == steps => Ok(trajectory),
        goal if goal < steps => Ok(cut(trajectory, goal, spec)),
        goal => Err(format!("expected a goal within its {steps} steps, found it after {goal}")),
    }
}

/// The first `steps` steps of a trajectory, which lead to the goal.
fn cut(trajectory: Trajectory, steps: u32, spec: &Spec) -> Trajectory {
    let first = |bytes: &Bytes, count: u32, one: usize| {
        bytes.slice(..bytes.len().min(count as usize * one))
    };
    let (observation, action) = (spec.observation.bytes(), spec.action.bytes());
    Trajectory {
        steps,
        cells: first(&trajectory.cells, steps + 1, observation),
        values: first(&trajectory.values, steps + 1, observation),
        discrete_actions: first(&trajectory.discrete_actions, steps, action),
        continuous_actions: first(&trajectory.continuous_actions, steps, action),
        environment_rewards: first(&trajectory.environment_rewards, steps, 4),
        ending: TrajectoryEnding::Terminated as i32,
        // It was that of the last state.
        state_hash: 0,
        ..trajectory
    }
}

/// What each number of a recorded action is multiplied with so that it acts alike under another
/// scale; none where both are the same.
fn factors(recorded: &[f32], own: &[f32]) -> Vec<f32> {
    if recorded == own {
        return Vec::new();
    }
    let factor = |scale: &[f32], index| scale.get(index).copied().unwrap_or(1.0);
    let numbers = 0..recorded.len().max(own.len());
    numbers.map(|index| factor(recorded, index) / factor(own, index)).collect()
}

fn rescaled(trajectory: Trajectory, factors: &[f32]) -> Trajectory {
    if factors.is_empty() {
        return trajectory;
    }
    let factors = factors.iter().cycle();
    let numbers = floats(&trajectory.continuous_actions).zip(factors);
    let numbers: Vec<f32> = numbers.map(|(number, factor)| number * factor).collect();
    Trajectory { continuous_actions: to_bytes(&numbers), ..trajectory }
}

/// Every demonstration of a file, each up to where it first reached the goal.
///
/// # Errors
/// [`Error::Demonstrations`] if the file is damaged, or lacks actions where they are needed.
pub fn read(file: &Path, spec: &Spec, with_actions: bool) -> Result<Vec<Trajectory>, Error> {
    rest(&mut FileReader::open(file)?, file, spec, with_actions)
}

/// What a reader has not given yet of a file of demonstrations.
fn rest(
    reader: &mut FileReader,
    file: &Path,
    spec: &Spec,
    with_actions: bool,
) -> Result<Vec<Trajectory>, Error> {
    let (mut trajectories, mut held) = (Vec::new(), 0);
    for entry in &mut *reader {
        let Record::Trajectory(bytes) = entry?.record else { continue };
        let (number, length) = (trajectories.len(), bytes.len());
        let of_this = |message: String| failed(file, format!("demonstration {number}: {message}"));
        let encoded = Encoded::decode(bytes, spec).map_err(|error| of_this(error.to_string()))?;
        let trajectory = encoded.trajectory;
        if !trajectory.success {
            return Err(of_this("expected one that reaches the goal".to_owned()));
        }
        if with_actions && trajectory.actions().is_empty() {
            let message =
                "expected the expert's actions, which this method needs, found states only";
            return Err(of_this(message.to_owned()));
        }
        held += length + size_of::<Trajectory>();
        if held > MOST_BYTES {
            return Err(of_this(format!("expected up to {} MiB in all", MOST_BYTES >> 20)));
        }
        trajectories.push(up_to_goal(trajectory, spec).map_err(of_this)?);
    }
    match reader.ending() {
        Some(Ending::Complete) => Ok(trajectories),
        Some(ending) => {
            Err(failed(file, format!("{ending}; `goalward log repair` keeps what is readable")))
        }
        None => Err(failed(file, "expected an end, found none".to_owned())),
    }
}

fn failed(file: &Path, message: String) -> Error {
    Error::Demonstrations { path: file.to_owned(), message }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_action_acts_alike_under_another_scale() {
        assert!(factors(&[0.4, 0.4], &[0.4, 0.4]).is_empty());
        assert_eq!(factors(&[0.5, 2.0], &[]), [0.5, 2.0]);
        assert_eq!(factors(&[], &[0.5, 2.0]), [2.0, 0.5]);
        let continuous_actions = to_bytes(&[1.0, 1.0, -2.0, 3.0]);
        let trajectory = Trajectory { continuous_actions, ..Trajectory::default() };
        let found = rescaled(trajectory, &factors(&[0.5, 2.0], &[0.25, 1.0])).continuous_actions;
        assert_eq!(floats(&found).collect::<Vec<_>>(), [2.0, 2.0, -4.0, 6.0]);
    }
}
