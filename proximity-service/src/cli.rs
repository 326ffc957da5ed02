//! The command line of `goalward-proximity-service`. Users run `goalward`, which starts it.

use std::fs;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::{Parser, Subcommand};
use protocol::durable;
use run::config::RunConfig;
use run::diagnostics::Diagnostics;
use run::folder::RunFolder;
use run::process::{self, Stop};
use serde::Serialize;

/// Learns the reward from demonstrations and agent experience, and answers for it.
#[derive(Debug, Parser)]
#[command(name = "goalward-proximity-service", version = protocol::build::version())]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Serves a run.
    Serve {
        /// Folder of the run.
        #[arg(long)]
        run: PathBuf,
    },
    /// Scores the episodes of a run's log again by another reward model.
    Rescore {
        /// Folder of the run.
        #[arg(long)]
        run: PathBuf,
        /// Folder of the log.
        #[arg(long)]
        log: PathBuf,
        /// Configuration of the other model; that of the run whose model scores, if there is one.
        #[arg(long)]
        config: PathBuf,
        /// Run whose trained model scores, without learning further.
        #[arg(long)]
        model: Option<PathBuf>,
        /// File for one line per episode.
        #[arg(long)]
        out: PathBuf,
    },
    /// Writes the reward model of a run as a file that other programs read.
    Export {
        /// Folder of the run.
        #[arg(long)]
        run: PathBuf,
        /// Iterations that its checkpoint is after; without it the newest.
        #[arg(long)]
        checkpoint: Option<u64>,
        /// The file, `.onnx` or `.safetensors`.
        #[arg(long)]
        out: PathBuf,
    },
    /// Reads an encoded episode from standard input and prints what it would have earned from a trained model.
    Score {
        /// Folder of the run that the episode is of.
        #[arg(long)]
        run: PathBuf,
        /// Configuration of the run whose model scores, with another reward.
        #[arg(long)]
        config: PathBuf,
        /// Run whose trained model scores; the same where none is named.
        #[arg(long)]
        model: Option<PathBuf>,
    },
    /// Reads observations from standard input and prints what the trained model of a run says of
    /// each.
    Estimate {
        /// Folder of the run.
        #[arg(long)]
        run: PathBuf,
        /// Iterations that its checkpoint is after; without it the newest.
        #[arg(long)]
        checkpoint: Option<u64>,
    },
}

impl Command {
    /// Returns the form of diagnostics: the service writes a log, one-off commands address the user.
    fn diagnostics(&self) -> Diagnostics {
        match self {
            Command::Serve { .. } => Diagnostics::of_service(),
            _ => Diagnostics::ForPeople,
        }
    }
}

/// Runs the process.
pub fn main() -> ExitCode {
    let arguments = Arguments::parse();
    process::run(arguments.command.diagnostics(), || match arguments.command {
        Command::Serve { run } => crate::run(&RunFolder::new(run), &Stop::at_end_of_input()?),
        Command::Rescore { run, log, config, model, out } => {
            process::end_with_parent()?;
            let config = configuration(&config)?;
            rescore(&RunFolder::new(run), &log, &config, model.map(RunFolder::new), &out)
        }
        Command::Export { run, checkpoint, out } => {
            print(&crate::export::export(&RunFolder::new(run), checkpoint, &out)?)
        }
        Command::Score { run, config, model } => {
            let config = configuration(&config)?;
            let trained = RunFolder::new(model.as_ref().unwrap_or(&run));
            let episode = input()?.into();
            print(&crate::estimate::score(&RunFolder::new(&run), &config, &trained, episode)?)
        }
        Command::Estimate { run, checkpoint } => estimate(&RunFolder::new(run), checkpoint),
    })
}

fn rescore(
    folder: &RunFolder,
    log: &Path,
    config: &RunConfig,
    model: Option<RunFolder>,
    out: &Path,
) -> Result<()> {
    // One line per episode. An existing file is replaced only when all lines are known.
    let mut lines = Vec::new();
    let comparison = crate::rescore::rescore(folder, log, config, model.as_ref(), &mut lines)?;
    durable::write(out, lines).with_context(|| out.display().to_string())?;
    print(&comparison)
}

fn estimate(folder: &RunFolder, checkpoint: Option<u64>) -> Result<()> {
    print(&crate::estimate::estimate(folder, checkpoint, &input()?)?)
}

fn configuration(file: &Path) -> Result<RunConfig> {
    let text = fs::read_to_string(file).with_context(|| format!("--config {}", file.display()))?;
    Ok(RunConfig::from_text(&text, &file.display().to_string())?)
}

fn input() -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    std::io::stdin().read_to_end(&mut bytes).context("standard input")?;
    Ok(bytes)
}

/// Prints a result as JSON, for `goalward` to read.
fn print(result: &impl Serialize) -> Result<()> {
    Ok(writeln!(std::io::stdout(), "{}", serde_json::to_string(result)?)?)
}
