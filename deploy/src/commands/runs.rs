//! `goalward runs`: the runs of folders, newest first.

use std::cmp::Reverse;
use std::path::PathBuf;

use anyhow::Result;
use run::folder::RunFolder;
use run::overview::{Overview, State};
use run::updates::begun;
use terminal::numbers;
use terminal::print::print_remark;

use crate::named_runs;
use crate::output_format::OutputFormat;

/// Stands for an unknown value.
const UNKNOWN: &str = "-";

/// Flags of `goalward runs`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Folders of runs, or folders that contain them, such as that of an experiment.
    #[arg(default_value = "runs", value_name = "RUNS")]
    folders: Vec<PathBuf>,
    #[command(flatten)]
    output: OutputFormat,
}

/// Prints a line for each run.
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let mut found = named_runs::at(&arguments.folders)?;
    found.sort_by_cached_key(|run| Reverse(begun(run)));
    let lines: Vec<Overview> = found.iter().filter_map(line).collect();
    arguments.output.print(&lines, |lines| table(lines, &arguments.folders))
}

/// Returns the overview of a run. A run that cannot be read is named in a remark and left out.
fn line(run: &RunFolder) -> Option<Overview> {
    Overview::of(run, print_remark).inspect_err(|error| print_remark(&error.to_string())).ok()
}

fn table(lines: &[Overview], folders: &[PathBuf]) -> String {
    if lines.is_empty() {
        let folders: Vec<_> = folders.iter().map(|path| path.display().to_string()).collect();
        return format!("no runs in {}", folders.join(", "));
    }
    let head = [
        "run",
        "state",
        "task",
        "method",
        "preset",
        "seed",
        "steps",
        "success",
        "evaluation",
        "time",
    ];
    let share =
        |rate: Option<f64>| rate.map_or(UNKNOWN.to_owned(), |rate| numbers::percent(rate, 1));
    let row = |line: &Overview| {
        let done = numbers::percent_done(line.environment_steps, line.steps_wanted);
        let steps = match line.state {
            State::Finished => numbers::count(line.environment_steps),
            State::Training | State::Failed | State::Stopped if line.steps_wanted == 0 => {
                UNKNOWN.to_owned()
            }
            State::Training | State::Failed | State::Stopped => {
                format!("{} ({done} %)", numbers::count(line.environment_steps))
            }
        };
        [
            line.run.display().to_string(),
            line.state.name().to_owned(),
            line.task.clone(),
            line.method.clone(),
            line.preset.clone(),
            line.seed.to_string(),
            steps,
            share(line.success_rate),
            share(line.evaluated_success_rate),
            line.wall_s.map_or(UNKNOWN.to_owned(), numbers::duration),
        ]
    };
    let rows: Vec<_> =
        std::iter::once(head.map(str::to_owned)).chain(lines.iter().map(row)).collect();
    numbers::columns(&rows)
}
