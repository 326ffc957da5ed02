//! `goalward runs`: the runs of a folder, newest first.

use std::path::{Path, PathBuf};
use std::time::SystemTime;

use anyhow::{Context, Result};
use run::folder::RunFolder;
use run::overview::{Overview, State};
use run::updates::begun;
use terminal::numbers;
use terminal::print::print_remark;
use terminal::refusal::wrong_usage;

use crate::figures::Figures;

/// Stands for an unknown value.
const UNKNOWN: &str = "-";

/// Flags of `goalward runs`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Folder that contains the folders of runs.
    #[arg(default_value = "runs")]
    folder: PathBuf,
    #[command(flatten)]
    figures: Figures,
}

/// Prints a line for each run.
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let folder = &arguments.folder;
    let mut found = runs_in(folder)?;
    found.sort_by_key(|(begun, run)| (std::cmp::Reverse(*begun), run.clone()));
    let lines: Vec<Overview> = found.into_iter().filter_map(|(_, run)| line(run)).collect();
    arguments.figures.print(&lines, |lines| table(lines, folder))
}

/// Returns the runs directly in a folder, and when each was begun.
fn runs_in(folder: &Path) -> Result<Vec<(SystemTime, PathBuf)>> {
    let entries = folder.read_dir().map_err(|error| {
        wrong_usage(format!("expected a folder of runs, {}: {error}", folder.display()))
    })?;
    let mut runs = Vec::new();
    for entry in entries {
        let path = entry.with_context(|| folder.display().to_string())?.path();
        let run = RunFolder::new(&path);
        if run.config_file().exists() {
            runs.push((begun(&run).unwrap_or(SystemTime::UNIX_EPOCH), path));
        }
    }
    Ok(runs)
}

/// Returns the overview of a run. A run that cannot be read is named in a remark and left out.
fn line(path: PathBuf) -> Option<Overview> {
    Overview::of(&RunFolder::new(path), print_remark)
        .inspect_err(|error| print_remark(&error.to_string()))
        .ok()
}

fn table(lines: &[Overview], folder: &Path) -> String {
    if lines.is_empty() {
        return format!("no runs in {}", folder.display());
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
            State::Live | State::Stopped if line.steps_wanted == 0 => UNKNOWN.to_owned(),
            State::Live | State::Stopped => {
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
