//! `goalward runs`: the runs of a folder, newest first.

use std::path::{Path, PathBuf};
use std::time::SystemTime;

use anyhow::{Context, Result};
use mcap_log::{Contents, Record, read_contents};
use run::folder::RunFolder;
use run::summary::Summary;
use serde::Serialize;
use terminal::numbers;
use terminal::print::print_remark;
use terminal::refusal::wrong_usage;

use crate::figures::Figures;
use crate::plan;

/// What stands for what is not known.
const UNKNOWN: &str = "-";

/// Flags of `goalward runs`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Folder that has the folders of runs.
    #[arg(default_value = "runs")]
    folder: PathBuf,
    #[command(flatten)]
    figures: Figures,
}

/// How far a run is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
enum State {
    Live,
    Finished,
    Stopped,
}

/// A run in a line.
#[derive(Debug, Serialize)]
struct Line {
    run: PathBuf,
    state: State,
    task: String,
    method: String,
    preset: String,
    seed: u64,
    environment_steps: u64,
    steps_wanted: u64,
    /// Of the last 100 training episodes.
    success_rate: Option<f64>,
    /// Of the evaluation at the end.
    evaluated_success_rate: Option<f64>,
    wall_s: Option<f64>,
}

/// Prints a line for each run.
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let folder = &arguments.folder;
    let mut found = runs_in(folder)?;
    found.sort_by_key(|(begun, run)| (std::cmp::Reverse(*begun), run.clone()));
    let lines: Vec<Line> = found.into_iter().filter_map(|(_, run)| line(run)).collect();
    arguments.figures.print(&lines, |lines| table(lines, folder))
}

/// The runs right in a folder, and when each was begun.
fn runs_in(folder: &Path) -> Result<Vec<(SystemTime, PathBuf)>> {
    let entries = folder.read_dir().map_err(|error| {
        wrong_usage(format!("expected a folder of runs, {}: {error}", folder.display()))
    })?;
    let mut runs = Vec::new();
    for entry in entries {
        let path = entry.with_context(|| folder.display().to_string())?.path();
        if let Ok(metadata) = RunFolder::new(&path).config_file().metadata() {
            runs.push((metadata.modified().unwrap_or(SystemTime::UNIX_EPOCH), path));
        }
    }
    Ok(runs)
}

/// What is to be said of a run; one that cannot be read costs its line and is named.
fn line(path: PathBuf) -> Option<Line> {
    let folder = RunFolder::new(&path);
    let config = match folder.config() {
        Ok(config) => config,
        Err(error) => {
            print_remark(&error.to_string());
            return None;
        }
    };
    let mut line = Line {
        run: path,
        state: State::Stopped,
        task: config.task.name,
        method: config.method,
        preset: config.preset,
        seed: config.seed,
        environment_steps: 0,
        steps_wanted: config.steps,
        success_rate: None,
        evaluated_success_rate: None,
        wall_s: None,
    };
    if let Some(summary) = Summary::of_finished(&folder, print_remark) {
        line.state = State::Finished;
        line.environment_steps = summary.env_steps;
        line.success_rate = summary.success_rate;
        line.evaluated_success_rate = summary.evaluation.success_rate;
        line.wall_s = Some(summary.wall_s);
        return Some(line);
    }
    if plan::lock(&folder).is_err() {
        line.state = State::Live;
    }
    let updates = read_contents(&folder.log(), Contents::Updates).into_iter().flatten().flatten();
    let newest = updates.filter_map(|entry| match entry.record {
        Record::PolicyUpdate(update) => Some(update),
        _ => None,
    });
    if let Some(update) = newest.last() {
        line.environment_steps = update.environment_steps;
        line.success_rate = Some(update.success_rate);
    }
    Some(line)
}

fn table(lines: &[Line], folder: &Path) -> String {
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
    let row = |line: &Line| {
        let state = match line.state {
            State::Live => "live".to_owned(),
            State::Finished => "finished".to_owned(),
            State::Stopped => "stopped".to_owned(),
        };
        let done = numbers::percent_done(line.environment_steps, line.steps_wanted);
        let steps = match line.state {
            State::Finished => numbers::count(line.environment_steps),
            State::Live | State::Stopped => {
                format!("{} ({done} %)", numbers::count(line.environment_steps))
            }
        };
        [
            line.run.display().to_string(),
            state,
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
