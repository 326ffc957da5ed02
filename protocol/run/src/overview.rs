//! A run in one line: what it is and how far it has come.

use std::path::PathBuf;

use protocol::Error;
use serde::Serialize;

use crate::folder::RunFolder;
use crate::holder::{Holder, Work};
use crate::summary::Summary;
use crate::updates::policy_updates;

/// The state of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum State {
    /// A `goalward train` holds it.
    Training,
    /// It has a summary.
    Finished,
    /// Neither, because its last training failed; it can be resumed.
    Failed,
    /// None of these; it can be resumed.
    Stopped,
}

impl State {
    /// Returns the name shown to users.
    pub fn name(self) -> &'static str {
        match self {
            State::Training => "training",
            State::Finished => "finished",
            State::Failed => "failed",
            State::Stopped => "stopped",
        }
    }

    /// Returns the state of a run that is not finished.
    fn of_unfinished(folder: &RunFolder) -> State {
        match folder.is_trained() {
            true => State::Training,
            false if failure(folder).is_some() => State::Failed,
            false => State::Stopped,
        }
    }
}

/// Returns why the last training of a run failed; `None` if it did not fail, or another work was done since.
pub fn failure(folder: &RunFolder) -> Option<String> {
    let Holder { work, failure, .. } = folder.last_holder();
    failure.filter(|_| work == Work::Training)
}

/// A run in one line.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Overview {
    /// Its folder.
    pub run: PathBuf,
    /// Its state.
    pub state: State,
    /// Name of the task.
    pub task: String,
    /// Name of the method.
    pub method: String,
    /// Name of the preset.
    pub preset: String,
    /// Its seed.
    pub seed: u64,
    /// Environment steps learned from.
    pub environment_steps: u64,
    /// Environment steps that it takes in all.
    pub steps_wanted: u64,
    /// Success rate of the last 100 training episodes.
    pub success_rate: Option<f64>,
    /// Success rate of the evaluation at the end.
    pub evaluated_success_rate: Option<f64>,
    /// Wall time of training, seconds.
    pub wall_s: Option<f64>,
}

impl Overview {
    /// Returns the overview of a run. Whatever cannot be read in its log is left out; `remark` is
    /// called if its summary is damaged.
    ///
    /// # Errors
    /// If its configuration is missing or cannot be read.
    pub fn of(folder: &RunFolder, remark: impl FnOnce(&str)) -> Result<Overview, Error> {
        let config = folder.config()?;
        let begun = Overview {
            run: folder.path().to_owned(),
            state: State::of_unfinished(folder),
            steps_wanted: config.steps_wanted(),
            task: config.task.name,
            method: config.method,
            preset: config.preset,
            seed: config.seed,
            environment_steps: 0,
            success_rate: None,
            evaluated_success_rate: None,
            wall_s: None,
        };
        Ok(match Summary::of_finished(folder, remark) {
            Some(summary) => begun.finished(&summary),
            None => begun.under_way(folder),
        })
    }

    fn finished(self, summary: &Summary) -> Overview {
        Overview {
            state: State::Finished,
            environment_steps: summary.environment_steps,
            success_rate: summary.success_rate,
            evaluated_success_rate: summary.evaluation.success_rate,
            wall_s: Some(summary.wall_s),
            ..self
        }
    }

    fn under_way(self, folder: &RunFolder) -> Overview {
        let newest = policy_updates(folder).into_iter().flatten().flatten().last();
        match newest {
            Some(update) => Overview {
                environment_steps: update.environment_steps,
                success_rate: Some(update.success_rate).filter(|rate| rate.is_finite()),
                wall_s: Some(update.wall_s),
                ..self
            },
            None => self,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use crate::tasks::configuration;

    #[test]
    fn a_run_that_failed_is_told_from_one_that_was_stopped() {
        let directory = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(directory.path());
        let config = configuration("navigation", None, &[]).unwrap();
        fs::write(folder.config_file(), config.to_text()).unwrap();
        let state = || Overview::of(&folder, |_| {}).unwrap().state;
        assert_eq!(state(), State::Stopped);
        for (work, reason, expected) in [
            ("training", r#""the expert raised""#, State::Failed),
            ("training", "null", State::Stopped),
            ("publishing", r#""the disk is full""#, State::Stopped),
        ] {
            let holder = format!(r#"{{"work":"{work}","process":12,"failure":{reason}}}"#);
            fs::write(folder.lock_file(), holder).unwrap();
            assert_eq!(state(), expected, "{work}, {reason}");
        }
        let lock = fs::File::open(folder.lock_file()).unwrap();
        lock.lock().unwrap();
        fs::write(folder.lock_file(), "").unwrap();
        assert_eq!(state(), State::Training);
    }
}
