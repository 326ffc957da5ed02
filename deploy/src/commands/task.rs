//! `goalward task`: writes the task's file of a Python environment, which is started once to describe itself.

use std::path::PathBuf;

use anyhow::{Context, Result};
use protocol::durable;
use terminal::print::print_line;
use terminal::refusal::wrong_usage;

use crate::{destination, tasks};

/// Flags of `goalward task`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// The environment: gym:ID, gym:module:ID, or python:module:function.
    #[arg(value_name = "gym:ID|python:MODULE:FUNCTION")]
    task: String,
    /// Sets an environment key, such as environment.kwargs.x=3; can be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    settings: Vec<String>,
    /// The file to write.
    #[arg(long, value_name = "FILE.toml")]
    out: PathBuf,
    /// Overwrites an existing file, but never one in a run's folder.
    #[arg(long)]
    force: bool,
}

/// Writes a task's file.
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let Arguments { task, settings, out, force } = arguments;
    if !tasks::is_of_python(task) {
        let expected = "expected gym:ID, gym:module:ID or python:module:function";
        return Err(wrong_usage(format!("{expected}, found {task}")));
    }
    // Other settings belong to a run, not to its task.
    let stranger = settings.iter().find(|setting| !setting.starts_with("environment."));
    if let Some(found) = stranger {
        return Err(wrong_usage(format!("--set: expected environment.KEY=VALUE, found {found}")));
    }
    destination::file(out, *force)?;
    let description = tasks::of_python(task, settings)?;
    tasks::remark_without_success(&description.task, settings);
    let text = tasks::file_of(description)?;
    durable::write(out, text).with_context(|| out.display().to_string())?;
    print_line(&format!("{}", out.display()));
    Ok(())
}
