//! `goalward methods`: lists the methods.

use anyhow::Result;
use run::tasks;
use serde::Serialize;
use terminal::numbers;

use crate::output_format::OutputFormat;

/// Flags of `goalward methods`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    #[command(flatten)]
    output: OutputFormat,
}

/// What a method needs, and what it is.
#[derive(Debug, Serialize)]
struct Method {
    name: String,
    about: String,
    learner: &'static str,
    reward_model: &'static str,
    needs_actions: bool,
}

/// Prints all methods, as they are configured for NAVIGATION.
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let methods = tasks::methods().into_iter().map(method).collect::<Result<Vec<_>>>()?;
    arguments.output.print(&methods, |methods| table(methods))
}

fn method((name, about): (String, String)) -> Result<Method> {
    let config = tasks::configuration(tasks::DEFAULT_TASK, None, &[format!("method={name}")])?;
    Ok(Method {
        learner: config.learner.name(),
        reward_model: config.reward.model.name,
        needs_actions: config.needs_expert_actions(),
        name,
        about,
    })
}

fn table(methods: &[Method]) -> String {
    let head = ["method", "learner", "reward model", "expert's actions", "what it is"];
    let rows = methods.iter().map(|method| {
        let actions = if method.needs_actions { "needed" } else { "" };
        let columns = [&method.name, method.learner, method.reward_model, actions, &method.about];
        columns.map(str::to_owned)
    });
    numbers::columns(&std::iter::once(head.map(str::to_owned)).chain(rows).collect::<Vec<_>>())
}
