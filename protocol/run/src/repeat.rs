//! How a run is repeated: the command line that gives the run's configuration.

use std::fmt::Display;

use protocol::Error;
use protocol::table::ABSENT;
use serde::Serialize;

use crate::config::RunConfig;
use crate::demonstrations::file_of;
use crate::folder::RunFolder;
use crate::tasks;

/// Keys that have their own flags.
const WITH_FLAGS: [&str; 4] = ["method", "preset", "seed", "steps"];

/// A setting that differs from the defaults of the run's task, preset and method.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Difference {
    /// Its key in the task's file.
    pub key: String,
    /// The run's value, as TOML.
    pub value: String,
    /// The default value, as TOML.
    pub default: String,
}

/// Returns the settings of a run that differ from the defaults of its task, preset and method, except seed and steps.
pub fn differences(config: &RunConfig) -> Vec<Difference> {
    // This version may lack the run's task, preset or method; the run's own configuration then says all.
    usual(config).map(|usual| changes(config, &usual)).unwrap_or_default()
}

/// Returns the same against given defaults, also for a user's own task.
pub fn changes(config: &RunConfig, usual: &RunConfig) -> Vec<Difference> {
    let differences = config.result_differences(usual).into_iter();
    differences
        .filter(|(key, _)| !WITH_FLAGS.contains(&key.as_str()))
        .map(|(key, [value, default])| Difference { key, value, default })
        .collect()
}

/// Returns whether the defaults of a run's task are known, as they are for the tasks that come with Goalward.
pub fn is_of_ours(config: &RunConfig) -> bool {
    usual(config).is_ok()
}

/// Returns the defaults of a run's task, preset and method.
fn usual(config: &RunConfig) -> Result<RunConfig, Error> {
    let method = format!("method={}", config.method);
    tasks::configuration(&config.task.name, Some(&config.preset), &[method])
}

/// Returns the [`differences`] of a run as keys and values.
pub fn settings(config: &RunConfig) -> Vec<(String, String)> {
    let differences = differences(config).into_iter();
    differences.map(|it| (it.key, unquoted(&it.value))).collect()
}

/// Returns a value in the form that `--set` takes.
pub fn unquoted(value: &str) -> String {
    value.trim_matches('"').to_owned()
}

/// Returns the command line that repeats a run. For a user's own task it names the run's own configuration.
pub fn command(folder: &RunFolder, config: &RunConfig) -> String {
    let RunConfig { task, method, preset, seed, steps, .. } = config;
    if !is_of_ours(config) {
        return format!("goalward train {}", quoted(folder.config_file().display()));
    }
    let mut line = format!("goalward train {task} --method {method} --preset {preset}");
    line += &format!(" --seed {seed} --steps {steps}");
    // Keys that a demonstrations file does not tell are absent; adopting the file leaves them out again.
    for Difference { key, value, .. } in
        differences(config).into_iter().filter(|it| it.value != ABSENT)
    {
        let value = unquoted(&value);
        line += &match key.as_str() {
            "demonstrations.file" => {
                format!(" --demonstrations {}", quoted(file_of(folder, config).display()))
            }
            _ => format!(" --set {}", quoted(format!("{key}={value}"))),
        };
    }
    line
}

/// Quotes a word for a shell if it needs quotes.
pub fn quoted(word: impl Display) -> String {
    let word = word.to_string();
    let is_plain = |letter: char| letter.is_alphanumeric() || "._-=/:,+".contains(letter);
    if !word.is_empty() && word.chars().all(is_plain) {
        return word;
    }
    format!("'{}'", word.replace('\'', r"'\''"))
}

#[cfg(test)]
mod tests {

    use super::*;

    #[test]
    fn words_are_quoted_for_a_shell() {
        assert_eq!(quoted("/a/b-1.toml"), "/a/b-1.toml");
        assert_eq!(quoted("it's"), r"'it'\''s'");
        assert_eq!(quoted(""), "''");
    }

    #[test]
    fn a_command_makes_its_configuration_again() {
        let changes = ["seed=3", "steps=60000", "reward.form=absolute", "reward.hidden=[8, 16]"];
        let changes = changes.map(str::to_owned);
        let config = tasks::configuration("navigation", Some("paper"), &changes).unwrap();
        assert_eq!(
            command(&RunFolder::new("runs/a"), &config),
            "goalward train navigation --method goal-proximity --preset paper --seed 3 \
             --steps 60000 --set reward.form=absolute --set 'reward.hidden=[8, 16]'"
        );
    }
}
