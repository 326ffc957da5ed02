//! `goalward config`: the keys of a configuration, their values, and remarks on them.

use std::collections::BTreeMap;

use anyhow::Result;
use protocol::table::flat;
use run::config::RunConfig;
use run::tasks::DEFAULT_TASK;
use serde::Serialize;
use terminal::numbers;
use terminal::refusal::wrong_usage;

use crate::output_format::OutputFormat;
use crate::{choices, tasks};

/// Flags of `goalward config`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Lists only keys that contain one of these, such as ppo. or uncertainty; by default all keys.
    parts: Vec<String>,
    /// The task: a name, the path of a task's file, or an environment of Python such as gym:CartPole-v1.
    #[arg(long, default_value = DEFAULT_TASK)]
    task: String,
    /// Preset to start from: goalward, paper or authors; by default goalward.
    #[arg(long, value_parser = choices::presets())]
    preset: Option<String>,
    /// The method, by default goal-proximity; `goalward methods` says what each is.
    #[arg(long, value_parser = choices::methods())]
    method: Option<String>,
    #[command(flatten)]
    output: OutputFormat,
}

/// A key of a configuration.
#[derive(Debug, Serialize)]
struct Key {
    key: String,
    value: toml::Value,
    remark: Option<String>,
}

/// Prints the keys that `--set` can change, with the values that they have without it.
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let Arguments { parts, task, preset, method, output } = arguments;
    let method: Vec<String> = method.iter().map(|method| format!("method={method}")).collect();
    let config = tasks::configuration(task, preset.as_deref(), &method)?;
    let values = listed(&config, parts)?.into_iter();
    let remark = |key: &str| {
        let unread = config.why_unread(key).map(|why| format!("not read: {why}"));
        unread.or_else(|| config.remark(key).map(str::to_owned))
    };
    let keys: Vec<Key> =
        values.map(|(key, value)| Key { remark: remark(&key), key, value }).collect();
    if keys.is_empty() {
        let expected =
            format!("expected a part of a key such as ppo.clip, found {}", parts.join(" "));
        return Err(wrong_usage(match of_other_methods(arguments) {
            Some((key, methods)) => {
                format!("{expected}: {key} is a key of --method {}", methods.join(" or "))
            }
            None => expected,
        }));
    }
    output.print(&keys, |keys| table(keys))
}

/// Returns the keys that contain one of `parts`, or all keys if there are none, with their values. The task, preset and
/// method are chosen by flags of their own.
fn listed(config: &RunConfig, parts: &[String]) -> Result<BTreeMap<String, toml::Value>> {
    let mut values = flat(&toml::Table::try_from(config)?);
    values.retain(|key, _| {
        let is_wanted = parts.is_empty() || parts.iter().any(|part| key.contains(part));
        !key.starts_with("task.") && key != "preset" && key != "method" && is_wanted
    });
    Ok(values)
}

/// Returns the first key of any method that contains one of the parts, with all methods that have it.
fn of_other_methods(arguments: &Arguments) -> Option<(String, Vec<String>)> {
    let Arguments { parts, task, preset, .. } = arguments;
    // A Python environment would be started once for each method.
    let task = if tasks::is_of_python(task) { DEFAULT_TASK } else { task.as_str() };
    let mut found: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for (method, _) in run::tasks::methods() {
        // A method may not fit the task.
        let config = tasks::configuration(task, preset.as_deref(), &[format!("method={method}")]);
        let keys = config.and_then(|config| listed(&config, parts)).unwrap_or_default();
        for key in keys.into_keys() {
            found.entry(key).or_default().push(method.clone());
        }
    }
    found.into_iter().next()
}

fn table(keys: &[Key]) -> String {
    let head = ["key", "value", ""].map(str::to_owned);
    let rows = keys.iter().map(|Key { key, value, remark }| {
        [key.clone(), value.to_string(), remark.clone().unwrap_or_default()]
    });
    numbers::columns(&std::iter::once(head).chain(rows).collect::<Vec<_>>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_that_only_other_methods_have_is_told_with_them() {
        let refused = |part: &str| {
            let arguments = Arguments {
                parts: vec![part.to_owned()],
                task: DEFAULT_TASK.to_owned(),
                preset: None,
                method: None,
                output: OutputFormat::default(),
            };
            run(&arguments).unwrap_err().to_string()
        };
        let said = refused("sqil.expert_after_goal");
        assert!(said.contains(": sqil.expert_after_goal is a key of --method sqil"), "{said}");
        assert!(refused("no.such").ends_with("such as ppo.clip, found no.such"));
    }
}
