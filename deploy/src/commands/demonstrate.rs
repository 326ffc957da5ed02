//! `goalward demonstrate`: a task's expert records demonstrations.
//!
//! The actor does it; this only passes on what the user wants.

use std::path::PathBuf;

use anyhow::Result;
use protocol::setting::{EXPERT, Setting};
use run::config::{DEFAULT_PRESET, RunConfig};
use toml::Value;

use crate::demonstrations::Recording;
use crate::tasks;
use crate::{description, destination, machine, programs};
use terminal::refusal::stopped;
use terminal::status_line::StatusLine;

/// Flags of `goalward demonstrate`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Task: navigation, fetch-pick, fetch-push, ant-reach, the path of a task's file, or an environment of
    /// Python such as gym:CartPole-v1.
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
    /// Who demonstrates in an environment of Python: called with the environment when an episode has begun,
    /// it gives what makes actions of observations.
    #[arg(long, value_name = "MODULE:FUNCTION", conflicts_with = "policy")]
    expert: Option<String>,
    /// A value of the environment, such as environment.kwargs.x=3; may be given more than once.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    settings: Vec<String>,
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
    let &Arguments { ref task, episodes, ref policy, seed, ref out, force, .. } = arguments;
    destination::file(out, force)?;
    let config = tasks::configuration(task, DEFAULT_PRESET, &arguments.settings)?;
    let task = &config.task;
    machine::require_end(episodes as f64 * f64::from(task.spec().horizon_steps), 0.0)?;
    let setting = setting(arguments, &config);
    let setting = description::complete_setting(task, &setting, policy.is_none())?;
    let policy = policy.as_deref();
    let recording = Recording { task, episodes, setting, policy, seed, file: out, force };
    match recording.record(&mut recording.actor()?, StatusLine::new())? {
        Some(status) => programs::expect_success(status),
        None => Err(stopped()),
    }
}

/// What the flags make of the setting that a task's demonstrations are recorded in. Coverage and noise of
/// the task's file are for its runs: without a flag they are the environment's own.
fn setting(arguments: &Arguments, config: &RunConfig) -> Setting {
    let Arguments { coverage, noise, expert, .. } = arguments;
    let mut setting = config.demonstration_setting();
    for (key, value) in
        [("coverage", coverage.map(Value::Float)), ("noise", noise.map(Value::Float))]
    {
        setting.0.remove(key);
        setting.0.extend(value.map(|value| (key.to_owned(), value)));
    }
    let expert = expert.clone().map(|expert| (EXPERT.to_owned(), Value::String(expert)));
    setting.0.extend(expert);
    setting
}
