//! `goalward demonstrate`: a task's expert records demonstrations.
//!
//! The actor does it; this only passes on what the user wants.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Result;
use protocol::task::Task;

use crate::demonstrations::{self, Recording};
use crate::programs;
use crate::refusal::wrong_usage;

/// Flags of `goalward demonstrate`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Task: navigation.
    task: Task,
    /// Episodes to record.
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..))]
    episodes: u64,
    /// Part of starts and goals that demonstrations may use, above 0 and at most 1.
    #[arg(long, default_value_t = 1.0, value_parser = coverage)]
    coverage: f64,
    /// Seed of the starts and goals.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// MCAP file to write; it must not exist.
    #[arg(long, value_name = "FILE.mcap")]
    out: PathBuf,
}

/// Records demonstrations; the exit code is that of the actor.
pub(crate) fn run(arguments: &Arguments) -> Result<ExitCode> {
    let &Arguments { task, episodes, coverage, seed, ref out } = arguments;
    if out.exists() {
        return Err(wrong_usage(format!("{} exists and is not overwritten", out.display())));
    }
    let recording = Recording { task, episodes, coverage, seed, file: out };
    let status = demonstrations::record(&recording, std::process::Command::status)?;
    Ok(programs::exit_code(status))
}

fn coverage(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(part) if part > 0.0 && part <= 1.0 => Ok(part),
        _ => Err("expected a number above 0 and at most 1".to_owned()),
    }
}
