//! `goalward replay`: a run from its log.

mod retrain;
mod verify;

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Result;
use protocol::run::RunFolder;

/// Flags of `goalward replay`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Folder of the run.
    run: PathBuf,
    #[command(flatten)]
    what: What,
    /// Iterations to train again; by default all that the log has.
    #[arg(long, value_name = "ITERATION", conflicts_with = "verify")]
    until: Option<u64>,
    /// Folder for the run trained again; by default it is removed when all hashes are the same.
    #[arg(long, value_name = "DIR", conflicts_with = "verify")]
    out: Option<PathBuf>,
}

/// What is done with the log, one of these.
#[derive(Debug, clap::Args)]
#[group(required = true, multiple = false)]
struct What {
    /// Act every recorded episode again, on all cores, and compare bit for bit.
    #[arg(long)]
    verify: bool,
    /// Train again from the log alone, without environments, and compare the weights' hashes.
    #[arg(long)]
    retrain: bool,
}

/// Replays a run.
pub(crate) fn run(arguments: Arguments) -> Result<ExitCode> {
    let folder = RunFolder::new(arguments.run);
    if arguments.what.verify {
        folder.config()?;
        return verify::verify(&folder);
    }
    retrain::retrain(&folder, arguments.until, arguments.out)
}
