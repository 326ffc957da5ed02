//! `goalward config`: the keys of a configuration, their values, and remarks on them.

use anyhow::Result;
use protocol::table::flat;
use run::tasks::DEFAULT_TASK;
use serde::Serialize;
use terminal::numbers;
use terminal::refusal::wrong_usage;

use crate::figures::Figures;
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
    figures: Figures,
}

/// A key of a configuration.
#[derive(Debug, Serialize)]
struct Key {
    key: String,
    value: toml::Value,
    remark: Option<&'static str>,
}

/// Prints the keys that `--set` can change, with the values that they have without it.
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let Arguments { parts, task, preset, method, figures } = arguments;
    let method: Vec<String> = method.iter().map(|method| format!("method={method}")).collect();
    let config = tasks::configuration(task, preset.as_deref(), &method)?;
    let is_wanted = |key: &String| parts.is_empty() || parts.iter().any(|part| key.contains(part));
    let values = flat(&toml::Table::try_from(&config)?).into_iter();
    // The task, preset and method are chosen by flags of their own.
    let values = values.filter(|(key, _)| {
        !key.starts_with("task.") && key != "preset" && key != "method" && is_wanted(key)
    });
    let keys: Vec<Key> =
        values.map(|(key, value)| Key { remark: config.remark(&key), key, value }).collect();
    if keys.is_empty() {
        let parts = parts.join(" ");
        return Err(wrong_usage(format!(
            "expected a part of a key such as ppo.clip, found {parts}"
        )));
    }
    figures.print(&keys, |keys| table(keys))
}

fn table(keys: &[Key]) -> String {
    let head = ["key", "value", ""].map(str::to_owned);
    let rows = keys.iter().map(|Key { key, value, remark }| {
        [key.clone(), value.to_string(), remark.unwrap_or_default().to_owned()]
    });
    numbers::columns(&std::iter::once(head).chain(rows).collect::<Vec<_>>())
}
