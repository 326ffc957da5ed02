//! `goalward tasks`: lists the built-in tasks.

use anyhow::Result;
use protocol::task::{ActionSpec, ObservationSpec};
use run::tasks;
use serde::Serialize;
use terminal::numbers;

use crate::output_format::OutputFormat;

/// Flags of `goalward tasks`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    #[command(flatten)]
    output: OutputFormat,
}

/// What a task's agent sees and does, and for how long it is trained by default.
#[derive(Debug, Serialize)]
struct Task {
    name: &'static str,
    observation: ObservationSpec,
    action: ActionSpec,
    horizon_steps: u32,
    steps: u64,
    demonstrations: u64,
}

/// Prints all tasks.
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let tasks = tasks::names().map(task).collect::<Result<Vec<_>>>()?;
    arguments.output.print(&tasks, |tasks| table(tasks))
}

fn task(name: &'static str) -> Result<Task> {
    let config = tasks::configuration(name, None, &[])?;
    let spec = config.task.spec();
    Ok(Task {
        name,
        observation: spec.observation,
        action: spec.action,
        horizon_steps: spec.horizon_steps,
        steps: config.steps,
        demonstrations: config.demonstrations.episodes,
    })
}

fn table(tasks: &[Task]) -> String {
    let head =
        ["task", "observation", "action", "longest episode", "trained for", "demonstrations"];
    let rows = tasks.iter().map(|task| {
        let observation = match task.observation {
            ObservationSpec::Cells { height, width, classes } => {
                format!("{height} x {width} cells of {classes} classes")
            }
            ObservationSpec::Vector { len } => format!("{len} numbers"),
        };
        let action = match task.action {
            ActionSpec::Discrete { count } => format!("one of {count}"),
            ActionSpec::Continuous { len } => format!("{len} numbers"),
        };
        [
            task.name.to_owned(),
            observation,
            action,
            format!("{} steps", task.horizon_steps),
            format!("{} steps", numbers::count(task.steps)),
            numbers::count(task.demonstrations),
        ]
    });
    let rows: Vec<_> = std::iter::once(head.map(str::to_owned)).chain(rows).collect();
    numbers::columns(&rows)
        + "\nfor your own task, give the path of its file; `goalward task gym:CartPole-v1 --out \
           cart_pole.toml` writes one\n"
}
