//! `goalward demonstrate`: an expert acts, and its trajectories are recorded in a demonstrations file.

use std::path::{Path, PathBuf};
use std::slice;

use anyhow::{Context, Result, bail, ensure};
use mcap_log::{FileWriter, Kind, Topic};
use protocol::messages::Lease;
use protocol::task::Task;
use protocol::trajectory::{Encoded, Source, Trajectory};
use run::config::ActionChoice;
use run::headway::{Headway, Teller};
use run::metadata;
use run::origin::{RECORDED_BY, TASKS_OWN};
use run::process::Stop;
use serde::Serialize;

use crate::expert::ActingExpert;
use crate::factory::Factory;
use crate::lane::Lane;
use crate::python;

/// Number of episodes that an expert may fail per demonstration wanted.
const FAILURES_PER_DEMONSTRATION: u64 = 9;

/// A request to record demonstrations.
pub struct Request<'a> {
    /// The factory of the environment to record in.
    pub factory: Factory,
    /// Number of demonstrations.
    pub episodes: u64,
    /// Seed of the starts.
    pub seed: u64,
    /// The file to write.
    pub file: &'a Path,
    /// Whether the file may replace an existing one, which stays until the new one is complete.
    pub force: bool,
}

/// What was recorded, as it is printed.
#[derive(Debug, Serialize)]
pub struct Recorded {
    /// Number of demonstrations.
    pub episodes: u64,
    /// Transitions of all demonstrations together.
    pub steps: u64,
    /// Further episodes, in which the expert did not reach the goal; `None` if the task does not tell success.
    pub failures: Option<u64>,
    /// The file that holds the demonstrations.
    pub file: PathBuf,
}

/// Records demonstrations: episodes in which the expert reaches the goal, up to the goal. For a task that does
/// not tell success, it records whole episodes.
///
/// # Errors
/// When the expert fails too often, the disk refuses, or a stop is requested first; then no file is left.
pub fn demonstrate(request: &Request<'_>, expert: ActingExpert, stop: &Stop) -> Result<Recorded> {
    let Request { factory, episodes, seed, file, force } = request;
    let who = if expert.is_of_task() { TASKS_OWN } else { "a policy" };
    let environment = factory.make()?;
    let setting = expert.setting(&environment.setting(), factory.task.observed)?;
    let factory = factory.with_setting(setting.clone());
    let task = factory.described(&*environment);
    let metadata = metadata::of_task(Kind::Demonstrations, &task, *seed)
        .with("episodes", episodes)
        .with(RECORDED_BY, who)
        .with("setting", serde_json::to_string(&python::as_recorded(&setting))?);
    ensure!(*force || !file.exists(), "{} exists and is not overwritten", file.display());
    let mut demonstrator = Demonstrator::begin(&factory, &task, *seed, expert)?;
    let mut writer = FileWriter::create_anew(file, &metadata, &[Topic::Trajectory])?;
    let recorded = record(&mut writer, &mut demonstrator, request, stop);
    let recorded = recorded.and_then(|recorded| Ok(writer.seal().map(|()| recorded)?));
    if let Err(why) = &recorded {
        writer.discard().with_context(|| format!("{why:#}"))?;
    }
    recorded
}

fn record(
    writer: &mut FileWriter,
    demonstrator: &mut Demonstrator,
    request: &Request<'_>,
    stop: &Stop,
) -> Result<Recorded> {
    let Request { episodes, file, .. } = *request;
    let failures = demonstrator.tells_success.then_some(0);
    let mut recorded = Recorded { episodes: 0, steps: 0, failures, file: file.to_owned() };
    let mut teller = Teller::default();
    while recorded.episodes < episodes {
        let number = recorded.episodes;
        if stop.is_requested() {
            bail!("stopped after {number} of {episodes} demonstrations: none are kept");
        }
        let trajectory = demonstrator.next_episode()?;
        if !trajectory.success
            && let Some(failures) = &mut recorded.failures
        {
            *failures += 1;
            ensure!(
                *failures <= episodes * FAILURES_PER_DEMONSTRATION,
                "expected an expert that reaches the goal in one of {} episodes, found {failures} \
                 failures and {number} demonstrations",
                FAILURES_PER_DEMONSTRATION + 1
            );
            continue;
        }
        recorded.steps += u64::from(trajectory.steps);
        // The log time is the number of the demonstration, so demonstrations of one seed always give the same file.
        writer.trajectory(&Encoded::encode(trajectory), number)?;
        recorded.episodes += 1;
        teller.tell(Headway {
            episodes_done: recorded.episodes,
            episodes_wanted: episodes,
            steps_done: recorded.steps,
        });
    }
    Ok(recorded)
}

/// An expert that acts in one lane.
struct Demonstrator {
    tells_success: bool,
    task: String,
    expert: ActingExpert,
    lane: Lane,
    action: Vec<u8>,
}

impl Demonstrator {
    fn begin(
        factory: &Factory,
        task: &Task,
        seed: u64,
        expert: ActingExpert,
    ) -> Result<Demonstrator> {
        let lease = Lease {
            source: Source::Demonstration as i32,
            episodes_owed: u64::MAX,
            ..Lease::default()
        };
        let action = vec![0; task.action.bytes()];
        let lane = Lane::begin(lease, factory, None, seed)?;
        let Task { tells_success, .. } = *task;
        Ok(Demonstrator { tells_success, task: task.name.clone(), expert, lane, action })
    }

    fn next_episode(&mut self) -> Result<Trajectory> {
        loop {
            let ended = match &mut self.expert {
                ActingExpert::Script => {
                    let scripted = self.lane.episode.expert_action(&mut self.action)?;
                    ensure!(scripted, "{}: expected a scripted expert, found none", self.task);
                    self.lane.step(&self.action, None)?
                }
                ActingExpert::Policy(expert) => {
                    let lanes = slice::from_mut(&mut self.lane);
                    expert.policy.step(&expert.version, lanes, ActionChoice::Mode)?.pop()
                }
            };
            if let Some(trajectory) = ended {
                return Ok(trajectory);
            }
        }
    }
}
