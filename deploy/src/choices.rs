//! Known values of flags, which help texts list and shells complete.

use std::ffi::OsStr;

use clap::builder::{PossibleValue, PossibleValuesParser, StringValueParser, TypedValueParser};
use clap::{Arg, Command, Error};
use run::config::ActionChoice;
use run::tasks;

/// The known values of a flag. Other values are accepted, too, since a task's file may define its own; the code that
/// uses a value checks it.
#[derive(Clone, Debug)]
pub(crate) struct Known(Vec<String>);

/// Returns the names of the presets that the built-in tasks have.
pub(crate) fn presets() -> Known {
    Known(["goalward", "paper", "authors"].map(str::to_owned).to_vec())
}

/// Returns the names of the methods.
pub(crate) fn methods() -> Known {
    Known(tasks::methods().into_iter().map(|(name, _)| name).collect())
}

/// Returns a parser of the ways to choose a policy's actions.
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
