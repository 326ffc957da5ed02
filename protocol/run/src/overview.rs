//! A run in one line: what it is and how far it has come.

use std::path::PathBuf;

use protocol::Error;
use serde::Serialize;

use crate::folder::RunFolder;
use crate::summary::Summary;
use crate::updates::policy_updates;

/// The state of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum State {
    /// A `goalward train` holds it.
    Live,
    /// It has a summary.
    Finished,
    /// Neither; it can be resumed.
    Stopped,
}

impl State {
    /// Returns the name shown to users.
    pub fn name(self) -> &'static str {
        match self {
            State::Live => "live",
            State::Finished => "finished",
            State::Stopped => "stopped",
        }
    }
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
            state: if folder.is_trained() { State::Live } else { State::Stopped },
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
            environment_steps: summary.env_steps,
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
