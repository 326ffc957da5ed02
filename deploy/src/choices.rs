//! Values that a flag is known to take: help lists them, and shells complete them.

use std::ffi::OsStr;

use clap::builder::{PossibleValue, PossibleValuesParser, StringValueParser, TypedValueParser};
use clap::{Arg, Command, Error};
use run::config::ActionChoice;
use run::tasks;

/// Values that are listed. Others pass, since a task's file may bring its own; who needs one says what is wrong
/// with it.
#[derive(Clone, Debug)]
pub(crate) struct Known(Vec<String>);

/// Names of presets that our tasks have.
pub(crate) fn presets() -> Known {
    Known(["goalward", "paper", "authors"].map(str::to_owned).to_vec())
}

/// Names of methods.
pub(crate) fn methods() -> Known {
    Known(tasks::methods().into_iter().map(|(name, _)| name).collect())
}

/// How a policy's actions are chosen.
pub(crate) fn actions() -> impl TypedValueParser<Value = ActionChoice> {
    let all = [ActionChoice::Sample, ActionChoice::Mode].map(ActionChoice::name);
    PossibleValuesParser::new(all).try_map(|name| name.parse::<ActionChoice>())
}

impl TypedValueParser for Known {
    type Value = String;

    fn parse_ref(
        &self,
        command: &Command,
        argument: Option<&Arg>,
        value: &OsStr,
    ) -> Result<String, Error> {
        StringValueParser::new().parse_ref(command, argument, value)
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        Some(Box::new(self.0.iter().map(PossibleValue::new)))
    }
}
