//! `goalward demonstrate`: a task's expert records demonstrations.
//!
//! The actor does it; this only passes on what the user wants.

use std::fs;
use std::path::PathBuf;

use anyhow::{Context, Result};
use run::config::DEFAULT_PRESET;
use toml::Value;

use crate::demonstrations::Recording;
use crate::tasks;
use crate::{description, destination, machine, programs};
use terminal::refusal::stopped;
use terminal::status_line::StatusLine;

/// Flags of `goalward demonstrate`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Task: navigation, fetch-pick, fetch-push, ant-reach, or the path of a task's file.
    task: String,
    /// Episodes to record.
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..))]
    episodes: u64,
    /// Part of starts and goals that demonstrations may use, above 0 and at most 1; all of them
    /// unless it is given.
    #[arg(long, allow_negative_numbers = true)]
    coverage: Option<f64>,
    /// How far starts and goals spread, in the task's own measure.
    #[arg(long, allow_negative_numbers = true)]
    noise: Option<f64>,
    /// Run whose policy is the expert; without it the task's own expert is.
    #[arg(long, value_name = "RUN")]
    policy: Option<PathBuf>,
    /// Seed of the starts and goals.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// MCAP file to write.
    #[arg(long, value_name = "FILE.mcap")]
    out: PathBuf,
    /// Replaces a file that is there; never anything of a run.
    #[arg(long)]
    force: bool,
}

/// Records demonstrations; the exit code is that of the actor.
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let &Arguments { ref task, episodes, coverage, noise, ref policy, seed, ref out, force } =
        arguments;
    destination::file(out, force)?;
    let config = tasks::configuration(task, DEFAULT_PRESET, &[])?;
    let task = &config.task;
    machine::require_end(episodes as f64 * f64::from(task.spec().horizon_steps), 0.0)?;
    let mut setting = config.environment.clone();
    // What the task's file varies are the flags here, and without one the environment's default.
    config.demonstrations.environment.0.keys().for_each(|key| drop(setting.0.remove(key)));
    for (key, value) in [("coverage", coverage), ("noise", noise)] {
        setting.0.extend(value.map(|value| (key.to_owned(), Value::Float(value))));
    }
    let setting = description::complete_setting(task, &setting, policy.is_none())?;
    let policy = policy.as_deref();
    let recording = Recording { task, episodes, setting, policy, seed, file: out };
    if force {
        recording.remove_unfinished()?;
        if out.exists() {
            fs::remove_file(out).with_context(|| format!("removing {}", out.display()))?;
        }
    }
    match recording.record(&mut recording.actor()?, StatusLine::on_error())? {
        Some(status) => programs::expect_success(status),
        None => Err(stopped()),
    }
}
