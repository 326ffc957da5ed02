//! How a policy is evaluated.

use std::str::FromStr;

use protocol::Error;
use protocol::error::out_of_range;
use protocol::trajectory::Source;
use serde::{Deserialize, Serialize};

/// The evaluation at the end of training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EvaluationConfig {
    /// Number of episodes.
    pub episodes: u64,
    /// How actions are chosen.
    pub actions: ActionChoice,
}

impl EvaluationConfig {
    /// Returns how actions are chosen in episodes of a source: as configured in evaluations, otherwise sampled.
    pub fn actions_of(&self, source: Source) -> ActionChoice {
        if source == Source::Evaluation { self.actions } else { ActionChoice::Sample }
    }
}

/// How a policy's actions are chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ActionChoice {
    /// Sampled from the policy, as in training and in the paper's curves.
    Sample,
    /// The most probable action, or the mean.
    Mode,
}

impl ActionChoice {
    /// Returns its name in a configuration.
    pub fn name(self) -> &'static str {
        match self {
            ActionChoice::Sample => "sample",
            ActionChoice::Mode => "mode",
        }
    }
}

impl FromStr for ActionChoice {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self, Error> {
        match name {
            "sample" => Ok(ActionChoice::Sample),
            "mode" => Ok(ActionChoice::Mode),
            _ => Err(out_of_range("actions", "sample or mode", name)),
        }
    }
}
