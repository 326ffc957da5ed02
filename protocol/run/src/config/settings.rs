//! Reads settings, `key=value`, as users give them, and names the key that was likely meant by a misspelled one.

use std::collections::BTreeMap;

use protocol::Error;
use protocol::table::{flat, merge, parse_setting};
use toml::{Table, Value};

use super::line_of;

/// Keys that settings cannot change, and what to write on the command line instead.
const CHOICES: [(&str, &str); 2] = [("task", "goalward train"), ("preset", "--preset")];

/// Least similarity, up to 1, at which one key is taken for a misspelling of another.
const LIKE: f64 = 0.7;

/// Returns the keys that settings name, with their values.
///
/// # Errors
/// [`Error::ConfigurationText`] if a setting is not `key=value`, names a task or preset, or has a
/// number that is not finite.
pub fn set_by_user(settings: &[String]) -> Result<BTreeMap<String, Value>, Error> {
    Ok(flat(&merged(settings)?))
}

/// Merges settings into one table, later ones over earlier ones.
pub(crate) fn merged(settings: &[String]) -> Result<Table, Error> {
    let mut table = Table::new();
    for setting in settings {
        let refused = |message: &str| Error::ConfigurationText {
            origin: format!("--set {}", line_of(setting)),
            message: line_of(message),
        };
        let change = parse_setting(setting).map_err(|message| refused(&message))?;
        for (name, flag) in CHOICES {
            if let Some(choice) = change.get(name) {
                return Err(refused(&chosen_otherwise(&change, choice, flag)));
            }
        }
        if let Some((key, value)) = flat(&change).into_iter().find(|(_, value)| is_infinite(value))
        {
            return Err(refused(&format!("expected a finite {key}, found {value}")));
        }
        merge(&mut table, change);
    }
    Ok(table)
}

/// Returns how to change the task or preset, which a `change` by a setting names.
fn chosen_otherwise(change: &Table, choice: &Value, flag: &str) -> String {
    let key = flat(change).into_keys().next().unwrap_or_default();
    if key.starts_with("task.") {
        return format!("expected a key outside of `task`: {key} is set in the task's file");
    }
    let choice = choice.as_str().unwrap_or("NAME");
    format!("expected `{flag} {choice}`: --set would only change the name")
}

/// Returns whether a value is or holds a number that is infinite or NaN.
pub(super) fn is_infinite(value: &Value) -> bool {
    match value {
        Value::Float(number) => !number.is_finite(),
        Value::Array(values) => values.iter().any(is_infinite),
        Value::Table(values) => values.values().any(is_infinite),
        _ => false,
    }
}

/// Shortens a parser's error about an unknown key in a setting: it names the likely keys instead of
/// all keys. Other errors are returned as they are.
pub(super) fn with_likely_key(
    refused: Error,
    set: &BTreeMap<String, Value>,
    known: &BTreeMap<String, Value>,
) -> Error {
    let Error::ConfigurationText { message, .. } = &refused else { return refused };
    let is_refused = |key: &&String| message.contains(&format!("unknown field `{}`", name_of(key)));
    let Some(key) = set.keys().filter(|key| !known.contains_key(*key)).find(is_refused) else {
        return refused;
    };
    let likely = likely(key, known.keys().map(String::as_str));
    if likely.is_empty() {
        return refused;
    }
    let message = format!("expected an existing key, such as {}", likely.join(" or "));
    Error::ConfigurationText { origin: format!("--set {key}"), message }
}

/// Returns the keys of the same name in other tables or, if there are none, the most similar key.
fn likely<'a>(key: &str, known: impl Iterator<Item = &'a str> + Clone) -> Vec<&'a str> {
    let same: Vec<_> = known.clone().filter(|other| name_of(other) == name_of(key)).collect();
    if !same.is_empty() {
        return same;
    }
    let likeness = known.map(|other| (strsim::normalized_damerau_levenshtein(key, other), other));
    let most = likeness.max_by(|one, other| one.0.total_cmp(&other.0));
    most.filter(|(likeness, _)| *likeness >= LIKE).map(|(_, other)| other).into_iter().collect()
}

/// Returns a key without its table.
fn name_of(key: &str) -> &str {
    key.rsplit_once('.').map_or(key, |(_, name)| name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slip_is_told_the_key_that_was_meant() {
        let known =
            ["ppo.learning_rate", "reward.learning_rate", "ppo.clip", "reward.uncertainty", "seed"];
        let keys = |key| likely(key, known.into_iter()).join(" ");
        assert_eq!(keys("ppo.learning_rat"), "ppo.learning_rate");
        assert_eq!(keys("reward.uncertanty"), "reward.uncertainty");
        assert_eq!(keys("ppo.clp"), "ppo.clip");
        assert_eq!(keys("sede"), "seed");
        assert_eq!(keys("learning_rate"), "ppo.learning_rate reward.learning_rate");
        assert_eq!(keys("reward.clip"), "ppo.clip");
        assert_eq!(keys("reward.nothing"), "");
    }
}
