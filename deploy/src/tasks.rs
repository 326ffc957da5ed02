//! Tasks as the user names them: those of the paper, files, and Python environments, which are started once to describe
//! themselves.

use anyhow::{Result, anyhow};
use mcap_log::file::LONGEST_MESSAGE;
use protocol::description::Description;
use protocol::setting::{MAKE, SUCCESS, Setting};
use protocol::table::{merge, parse_setting};
use protocol::task::Task;
use protocol::trajectory::Trajectory;
use run::config::{RunConfig, set_by_user};
use run::tasks;
use serde::Serialize;
use terminal::print::print_remark;
use terminal::refusal::wrong_usage;
use toml::{Table, Value};

use crate::description;

/// Prefixes of the names of Python environments.
const OF_PYTHON: [&str; 2] = ["gym:", "python:"];

/// Default environment steps of an iteration of a Python task (Table 2: rollout size).
const ITERATION_STEPS: u64 = 4096;

/// Smallest default number of steps of a lane in an iteration.
const LANE_STEPS: u64 = 128;

/// Smallest default number of lanes.
const LANES: u64 = 4;

/// Default label of a state that is the longest episode away from the goal (Eq. 1, exponential). This is about the
/// label in the paper's tasks, whose longest episodes have 50 and 60 steps, with delta = 0.95.
const FARTHEST_LABEL: f64 = 0.05;

#[derive(Serialize)]
struct Reward {
    delta: f64,
}

/// Returns the effective configuration of a task under a preset, with `key=value` settings.
///
/// # Errors
/// Wrong usage, when there is no such task, or its configuration is invalid.
pub(crate) fn configuration(
    task: &str,
    preset: Option<&str>,
    settings: &[String],
) -> Result<RunConfig> {
    if !is_of_python(task) {
        return Ok(tasks::configuration(task, preset, settings)?);
    }
    let file = file_of(of_python(task, settings)?)?;
    Ok(tasks::of_text(&file, task, preset, settings)?)
}

/// Returns whether a name is that of a Python environment.
pub(crate) fn is_of_python(task: &str) -> bool {
    OF_PYTHON.iter().any(|kind| task.starts_with(kind))
}

/// A task's file.
#[derive(Serialize)]
struct File {
    task: Task,
    rollout: Rollout,
    reward: Reward,
    #[serde(skip_serializing_if = "Option::is_none")]
    log: Option<Log>,
    environment: Setting,
}

#[derive(Serialize)]
struct Rollout {
    lanes: u64,
    lane_steps: u64,
}

#[derive(Serialize)]
struct Log {
    observations: bool,
}

/// Returns the description of a Python environment, made with the keys of `environment` in `settings`.
///
/// # Errors
/// Wrong usage, when Python cannot make the environment, or its spaces do not fit a task.
pub(crate) fn of_python(task: &str, settings: &[String]) -> Result<Description> {
    let mut environment = Table::from_iter([(MAKE.to_owned(), Value::String(task.to_owned()))]);
    for setting in settings {
        let mut change = parse_setting(setting).map_err(wrong_usage)?;
        if let Some(Value::Table(own)) = change.remove("environment") {
            merge(&mut environment, own);
        }
    }
    description::of_python(&name_of(task), &Setting(environment))
}

/// Returns the text of the task's file of a Python environment.
///
/// # Errors
/// When the description cannot be written as TOML.
pub(crate) fn file_of(Description { task, environment, .. }: Description) -> Result<String> {
    // A lane ends an iteration with a whole episode, so in the next one it owes up to an episode less.
    let horizon = u64::from(task.horizon_steps);
    let lane_steps = LANE_STEPS.max(horizon + horizon.div_ceil(4));
    let rollout = Rollout { lanes: (ITERATION_STEPS / lane_steps).max(LANES), lane_steps };
    let (reward, log) = (Reward { delta: delta(task.horizon_steps) }, log(&task));
    toml::to_string(&File { task, rollout, reward, log, environment })
        .map_err(|error| anyhow!("the file of a task: {error}"))
}

/// Prints a remark if no success signal of a Python environment was found, and `settings` do not name one either.
pub(crate) fn remark_without_success(task: &Task, settings: &[String]) {
    let key = format!("environment.{SUCCESS}");
    let is_chosen = set_by_user(settings).is_ok_and(|set| set.contains_key(&key));
    if !task.tells_success && !is_chosen {
        print_remark(&format!(
            "{task}: found no success signal, so its runs have no success rate; environment.{SUCCESS} \
             names one, or `none`"
        ));
    }
}

/// Returns the base of exponential labels that gives [`FARTHEST_LABEL`] after the longest episode, to four decimals.
fn delta(horizon_steps: u32) -> f64 {
    (FARTHEST_LABEL.powf(1.0 / f64::from(horizon_steps)) * 1e4).round() / 1e4
}

/// Returns how a task is recorded if its longest episode is too long for the log: without observations, which acting it
/// again restores.
fn log(task: &Task) -> Option<Log> {
    let is_long = Trajectory::most_bytes(&task.spec(), true) > LONGEST_MESSAGE as u64;
    (is_long && task.deterministic).then_some(Log { observations: false })
}

/// Returns the name of the task of a Python environment: the last part of the environment's name, with characters
/// replaced that names of tasks cannot have.
fn name_of(task: &str) -> String {
    let last = task.rsplit(':').next().unwrap_or(task);
    let plain = |letter: char| {
        let is_plain = letter.is_ascii_alphanumeric() || "-_.".contains(letter);
        if is_plain { letter } else { '-' }
    };
    last.chars().map(plain).collect::<String>().trim_start_matches('.').to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::task::ObservationSpec;

    #[test]
    fn labels_reach_as_far_as_the_longest_episode() {
        assert_eq!([50, 58, 500, 1000].map(delta), [0.9418, 0.9497, 0.994, 0.997]);
    }

    #[test]
    fn observations_are_recorded_unless_there_are_too_many_of_an_episode() {
        let mut task = tasks::configuration("navigation", None, &[]).unwrap().task;
        assert!(log(&task).is_none());
        task.observation = ObservationSpec::Vector { len: 27_648 };
        task.horizon_steps = 1000;
        assert!(log(&task).is_some_and(|log| !log.observations));
        task.deterministic = false;
        assert!(log(&task).is_none());
    }

    #[test]
    fn tasks_of_python_are_called_by_the_last_part() {
        let names = ["gym:FetchPush-v4", "gym:minigrid:MiniGrid-FourRooms-v0", "python:a.b:make"];
        let expected = ["FetchPush-v4", "MiniGrid-FourRooms-v0", "make"];
        assert_eq!(names.map(name_of), expected);
        assert_eq!(name_of("gym:ns/Env v1"), "ns-Env-v1");
        assert!(
            is_of_python("gym:x") && !is_of_python("navigation") && !is_of_python("my_gym.toml")
        );
    }
}
