//! Reads the demonstrations of a run from their MCAP file.

use std::path::{Path, PathBuf};

use bytes::Bytes;
use mcap_log::{Ending, FileReader, Kind, Record, recorded_metadata};
use protocol::dropped::shortened;
use protocol::ending::Ending as TrajectoryEnding;
use protocol::seed::{self, Purpose};
use protocol::setting::{ACTION_SCALE, EXPERT, Setting, VERSIONS, is_same};
use protocol::table::{ABSENT, merge};
use protocol::task::{Spec, Task, floats};
use protocol::trajectory::{Encoded, Trajectory};
use protocol::weights::to_bytes;
use protocol::{Error, durable};
use rand::seq::SliceRandom;
use toml::{Table, Value};

use crate::config::{RewardConfig, RunConfig, merged_settings};
use crate::folder::RunFolder;
use crate::metadata::recorded_task;

/// Name of the folder of demonstrations in an experiment's folder, beside its folder of runs.
pub const SHARED_FOLDER: &str = "demonstrations";

/// Metadata key of a run's log with the SHA-256 of its demonstrations file.
pub const DEMONSTRATIONS_SHA256: &str = "demonstrations_sha256";

/// Name of the copy, in a run's folder, of the demonstrations that the user gave it.
const GIVEN_FILE: &str = "given-demonstrations.mcap";

/// Longest message about a file, characters.
const MESSAGE_CHARS: usize = 1000;

/// Most memory that demonstrations may take, bytes: hundreds of times what the paper's take.
const MOST_BYTES: usize = 1 << 30;

/// Returns the demonstrations file that a run learns from: the run's copy of the configured one, or this one itself
/// if there is no copy; without a configured one, the file that the expert recorded for the run, which may not exist
/// yet. If the configured file is missing, the experiment that contains the run may have been moved or be mounted
/// under another path: then the file of the same name in that experiment is returned, if there is one.
pub fn file_of(folder: &RunFolder, config: &RunConfig) -> PathBuf {
    let Some(given) = &config.demonstrations.file else { return folder.demonstrations_file() };
    let copy = folder.path().join(GIVEN_FILE);
    if copy.exists() {
        return copy;
    }
    if given.exists() {
        return given.clone();
    }
    let moved = in_experiment(folder, given).filter(|file| file.is_file());
    moved.unwrap_or_else(|| given.clone())
}

/// Returns the [`file_of`] a run if it is there.
///
/// # Errors
/// [`Error::Demonstrations`] if it is missing, with the place that a copy can be put in.
pub fn existing_file_of(folder: &RunFolder, config: &RunConfig) -> Result<PathBuf, Error> {
    let file = file_of(folder, config);
    if file.is_file() {
        return Ok(file);
    }
    let place = match config.demonstrations.file {
        Some(_) => folder.path().join(GIVEN_FILE),
        None => folder.demonstrations_file(),
    };
    let log = recorded_metadata(&folder.log()).unwrap_or_default();
    let hash = log.iter().find_map(|metadata| metadata.get(DEMONSTRATIONS_SHA256));
    let hash = hash.map(|hash| format!(" (SHA-256 {hash})")).unwrap_or_default();
    let message = format!(
        "expected the run's demonstrations{hash}, found no such file; a copy of them can be put at {}",
        place.display()
    );
    Err(failed(&file, message))
}

/// Copies the demonstrations that the user gave a run into its folder, so that the run does not depend on their file.
/// Those of an experiment stay there: its runs share them, and they move with it.
///
/// # Errors
/// The operating system's error, when the copy cannot be made.
pub fn keep_copy(folder: &RunFolder, config: &RunConfig) -> std::io::Result<()> {
    let Some(given) = &config.demonstrations.file else { return Ok(()) };
    let copy = folder.path().join(GIVEN_FILE);
    let is_shared = in_experiment(folder, given).as_ref() == Some(given);
    if copy.exists() || is_shared || !given.is_file() {
        return Ok(());
    }
    durable::copy(given, &copy)
}

/// Returns the path that a file of this name has in the experiment whose `runs/NAME` is the run's folder.
fn in_experiment(folder: &RunFolder, file: &Path) -> Option<PathBuf> {
    // A relative path may have no parent.
    let run = folder.path().canonicalize().ok()?;
    let experiment = run.parent()?.parent()?;
    Some(experiment.join(SHARED_FOLDER).join(file.file_name()?))
}

/// Reads the demonstrations that a run of this configuration learns from. If the file has more than
/// the configuration asks for, each seed takes its own subset. Each demonstration ends where it first
/// reached the goal, if the task tells success. Actions are converted to the run's own action scale.
///
/// # Errors
/// [`Error::Demonstrations`] if the file is damaged, is of another task or setting, has too few
/// demonstrations or rows, lacks actions that the method needs, or does not say where a goal was reached.
pub fn of_file(file: &Path, config: &RunConfig) -> Result<Vec<Trajectory>, Error> {
    let mut reader = open(file, &config.task)?;
    let recorded = setting(&reader, file)?;
    if let Some(recorded) = &recorded {
        require_setting(recorded, config, file)?;
    }
    let with_actions = config.needs_expert_actions();
    let mut trajectories = rest(&mut reader, file, &config.task, with_actions)?;
    let (found, wanted) = (trajectories.len(), config.demonstrations.episodes as usize);
    if found < wanted {
        let message = format!(
            "expected at least {wanted} demonstrations, found {found} (--set \
             demonstrations.episodes={found} uses only these)"
        );
        return Err(failed(file, message));
    }
    let mut chosen: Vec<usize> = (0..found).collect();
    chosen.shuffle(&mut seed::stream(config.seed, Purpose::DemonstrationSubset, 0, 0));
    chosen.truncate(wanted);
    chosen.sort_unstable();
    let factors =
        factors(&recorded.unwrap_or_default().action_scale(), &config.environment.action_scale());
    let taken = |at: usize| rescaled(std::mem::take(&mut trajectories[at]), &factors);
    let chosen: Vec<Trajectory> = chosen.into_iter().map(taken).collect();
    require_rows(&chosen, config, file)?;
    Ok(chosen)
}

/// Updates a configuration with what its demonstrations file says about the environment of the
/// demonstrations. Keys that the user's `settings` name keep the user's values. A file without a
/// setting counts as recorded in the agent's environment. If the file has fewer demonstrations than
/// the configuration asks for, and `settings` do not name a number, the run learns from all of them.
///
/// # Errors
/// [`Error::Demonstrations`] if the file cannot be read, or is of another task.
pub fn adopt(mut config: RunConfig, settings: &[String]) -> Result<RunConfig, Error> {
    if let Some(file) = &config.demonstrations.file {
        let reader = open(file, &config.task)?;
        let recorded = setting(&reader, file)?.unwrap_or_default();
        let mut named = match merged_settings(settings)?.remove("demonstrations") {
            Some(Value::Table(named)) => named,
            _ => Table::new(),
        };
        let held = reader.metadata().get("episodes").and_then(|count| count.parse::<u64>().ok());
        if let Some(held) = held.filter(|_| !named.contains_key("episodes")) {
            let wanted = &mut config.demonstrations.episodes;
            *wanted = held.clamp(1, (*wanted).max(1));
        }
        let own = &mut config.demonstrations.environment.0;
        named.retain(|key, _| own.contains_key(key));
        own.retain(|key, value| match recorded.0.get(key) {
            Some(recorded) => {
                *value = recorded.clone();
                true
            }
            None => named.contains_key(key),
        });
        merge(own, named);
    }
    Ok(config)
}

/// Returns whether a file says in which setting its demonstrations were recorded, such as starts,
/// goals and action scale.
///
/// # Errors
/// As [`adopt`].
pub fn tells_setting(file: &Path, task: &Task) -> Result<bool, Error> {
    Ok(setting(&open(file, task)?, file)?.is_some())
}

/// Opens a file and checks that it holds demonstrations of a task.
fn open(file: &Path, task: &Task) -> Result<FileReader, Error> {
    let reader = FileReader::open(file)?;
    let metadata = reader.metadata();
    if metadata.kind != Kind::Demonstrations {
        return Err(failed(file, "expected demonstrations, found the log of a run".to_owned()));
    }
    let found = metadata.get("task").unwrap_or("none");
    if found != task.name {
        let message = format!("expected demonstrations of the task {task}, found {found}");
        return Err(failed(file, message));
    }
    match recorded_task(metadata) {
        Some(found) if found.spec() != task.spec() => {
            Err(failed(file, format!("expected demonstrations with {}", difference(task, &found))))
        }
        _ => Ok(reader),
    }
}

/// Names what `task` has and the task of a file, `found`, has not.
fn difference(task: &Task, found: &Task) -> String {
    let pairs = task.spec().named().into_iter().zip(found.spec().named());
    let parts = pairs
        .filter(|(ours, theirs)| ours != theirs)
        .map(|((key, ours), (_, theirs))| format!("{key} = {ours}, found {theirs}"));
    parts.collect::<Vec<_>>().join("; ")
}

/// Returns the setting that demonstrations were recorded in, if their file has it.
fn setting(reader: &FileReader, file: &Path) -> Result<Option<Setting>, Error> {
    let Some(text) = reader.metadata().get("setting") else { return Ok(None) };
    let setting = serde_json::from_str(text);
    setting.map(Some).map_err(|error| failed(file, format!("setting: {error}, found {text}")))
}

/// Keys of the recorded setting that may differ from the run's, because states stay the same: the
/// action scale (actions are converted to the run's), the expert, and the package versions.
const MAY_DIFFER: [&str; 3] = [ACTION_SCALE, EXPERT, VERSIONS];

/// Refuses demonstrations that were recorded in a setting other than the configuration's.
fn require_setting(recorded: &Setting, config: &RunConfig, file: &Path) -> Result<(), Error> {
    let own = config.demonstration_setting();
    for (key, found) in recorded.0.iter().filter(|(key, _)| !MAY_DIFFER.contains(&key.as_str())) {
        let expected = own.0.get(key);
        if !expected.is_some_and(|expected| is_same(expected, found)) {
            let expected = expected.map_or(ABSENT.to_owned(), Value::to_string);
            let message = format!(
                "expected demonstrations.{key} = {expected}, found them recorded with {found}"
            );
            return Err(failed(file, message));
        }
    }
    Ok(())
}

/// Refuses demonstrations that have too few rows for one batch of the reward model, no two rows to
/// rank, or no state in one of its segments.
fn require_rows(
    demonstrations: &[Trajectory],
    config: &RunConfig,
    file: &Path,
) -> Result<(), Error> {
    let RewardConfig { model, input, batch, .. } = config.reward;
    let rows = demonstrations.iter().map(|one| model.rows(input, u64::from(one.steps)));
    let (rows, count) = (rows.sum::<u64>(), demonstrations.len());
    if model.trains && rows < batch as u64 {
        let message = format!(
            "expected at least reward.batch = {batch} rows, found {rows} in {count} demonstrations"
        );
        return Err(failed(file, message));
    }
    let ordered = |one: &Trajectory| model.rows(input, u64::from(one.steps)) > 1;
    if model.pairs && !demonstrations.iter().any(ordered) {
        let message = "expected a demonstration with two rows to rank, found none in all \
                       demonstrations";
        return Err(failed(file, message.to_owned()));
    }
    if model.reads_segments()
        && let Some(empty) = empty_segment(demonstrations, &config.reward)
    {
        let segments = config.reward.segments;
        let message = format!(
            "expected demonstrations with a state in each of the {segments} parts that \
             `reward.segments` divides them into, found none in part {}",
            empty + 1
        );
        return Err(failed(file, message));
    }
    Ok(())
}

/// Returns the first segment without a state.
fn empty_segment(demonstrations: &[Trajectory], config: &RewardConfig) -> Option<usize> {
    let mut found = vec![false; config.segments];
    for steps in demonstrations.iter().map(|one| one.steps as usize) {
        (0..=steps).for_each(|step| found[config.segment(step, steps)] = true);
    }
    found.iter().position(|found| !found)
}

/// Cuts a demonstration where it first reached the goal, so that it ends there: later states would
/// be labeled as if they were closer to it.
fn up_to_goal(trajectory: Trajectory, spec: &Spec) -> Result<Trajectory, String> {
    if !trajectory.success {
        return Err("expected one that reaches the goal".to_owned());
    }
    let Trajectory { steps, steps_to_goal, ending, .. } = trajectory;
    match steps_to_goal {
        0 if ending == TrajectoryEnding::GoalReached as i32 => Ok(trajectory),
        0 => Err("expected the step that reached the goal, or an end there, found neither".into()),
        goal if goal == steps => {
            Ok(Trajectory { ending: TrajectoryEnding::GoalReached as i32, ..trajectory })
        }
        goal if goal < steps => Ok(cut(trajectory, goal, spec)),
        goal => Err(format!("expected a goal within its {steps} steps, found it after {goal}")),
    }
}

/// Returns the first `steps` steps of a trajectory, which lead to the goal.
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
        ending: TrajectoryEnding::GoalReached as i32,
        // The hash was that of the last state, which is cut off.
        state_hash: 0,
        ..trajectory
    }
}

/// Returns the factors by which the numbers of a recorded action are multiplied to have the same
/// effect under the run's own scale; empty if both scales are the same.
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

/// Reads all demonstrations of a file, each up to where it first reached the goal, if the task tells success.
///
/// # Errors
/// [`Error::Demonstrations`] if the file is damaged, or a demonstration is of another task, does
/// not say where it reached the goal, or lacks actions that are needed.
pub fn read(file: &Path, task: &Task, with_actions: bool) -> Result<Vec<Trajectory>, Error> {
    rest(&mut FileReader::open(file)?, file, task, with_actions)
}

/// Reads the demonstrations that a reader of the file has not returned yet.
fn rest(
    reader: &mut FileReader,
    file: &Path,
    task: &Task,
    with_actions: bool,
) -> Result<Vec<Trajectory>, Error> {
    let (mut trajectories, mut held, spec) = (Vec::new(), 0, task.spec());
    for entry in &mut *reader {
        let Record::Trajectory(bytes) = entry?.record else { continue };
        let (number, length) = (trajectories.len(), bytes.len());
        let of_this = |message: String| failed(file, format!("demonstration {number}: {message}"));
        let encoded = Encoded::decode(bytes, &spec).map_err(|error| of_this(error.to_string()))?;
        let trajectory = encoded.trajectory;
        if trajectory.task != task.name {
            return Err(of_this(format!(
                "expected one of {task}, found one of {}",
                trajectory.task
            )));
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
        let whole = if task.tells_success { up_to_goal(trajectory, &spec) } else { Ok(trajectory) };
        trajectories.push(whole.map_err(of_this)?);
    }
    match reader.ending() {
        Some(Ending::Complete) => Ok(trajectories),
        Some(ending) => {
            Err(failed(file, format!("{ending}; `goalward log repair` keeps what is readable")))
        }
        None => Err(failed(file, "expected an end, found none".to_owned())),
    }
}

/// Returns an error whose message may hold texts of the file.
fn failed(file: &Path, message: String) -> Error {
    let message = shortened(&message, MESSAGE_CHARS);
    Error::Demonstrations { path: file.to_owned(), message }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn a_run_keeps_a_copy_of_what_it_was_given() {
        let place = tempfile::tempdir().unwrap();
        let place = place.path().canonicalize().unwrap();
        let folder = RunFolder::new(place.join("runs/one"));
        fs::create_dir_all(folder.path()).unwrap();
        let given = place.join("given.mcap");
        fs::write(&given, "some").unwrap();
        let mut config = crate::tasks::configuration("navigation", None, &[]).unwrap();
        keep_copy(&folder, &config).unwrap();
        config.demonstrations.file = Some(given.clone());
        assert_eq!(existing_file_of(&folder, &config).unwrap(), given, "nothing was given before");
        keep_copy(&folder, &config).unwrap();
        fs::write(&given, "other").unwrap();
        keep_copy(&folder, &config).unwrap();
        let copy = existing_file_of(&folder, &config).unwrap();
        assert_eq!(fs::read_to_string(&copy).unwrap(), "some");
        for file in [&copy, &given] {
            fs::remove_file(file).unwrap();
        }
        keep_copy(&folder, &config).unwrap();
        let said = existing_file_of(&folder, &config).unwrap_err().to_string();
        assert!(said.contains("given.mcap: expected the run's demonstrations, found no"), "{said}");
        assert!(said.ends_with(copy.to_str().unwrap()), "{said}");

        let shared = place.join(SHARED_FOLDER).join("shared.mcap");
        fs::create_dir(place.join(SHARED_FOLDER)).unwrap();
        fs::write(&shared, "some").unwrap();
        config.demonstrations.file = Some(shared.clone());
        keep_copy(&folder, &config).unwrap();
        assert_eq!(file_of(&folder, &config), shared);
    }

    #[test]
    fn demonstrations_are_found_where_their_experiment_is_now() {
        let place = tempfile::tempdir().unwrap();
        let place = place.path().canonicalize().unwrap();
        let folder = RunFolder::new(place.join("now/runs/one"));
        fs::create_dir_all(folder.path()).unwrap();
        let [given, moved] = ["before", "now"]
            .map(|experiment| place.join(experiment).join("demonstrations").join("some.mcap"));
        let mut config = crate::tasks::configuration("navigation", None, &[]).unwrap();
        config.demonstrations.file = Some(given.clone());
        assert_eq!(file_of(&folder, &config), given, "neither is there");
        for (written, expected) in [(&moved, &moved), (&given, &given)] {
            fs::create_dir_all(written.parent().unwrap()).unwrap();
            fs::write(written, "some").unwrap();
            assert_eq!(file_of(&folder, &config), *expected);
        }
        config.demonstrations.file = None;
        assert_eq!(file_of(&folder, &config), folder.demonstrations_file());
    }

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
