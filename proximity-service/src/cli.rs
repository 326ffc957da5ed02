//! The command line of `goalward-proximity-service`. People type `goalward train`, which starts it.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser;
use protocol::process::{self, Stop};
use protocol::run::RunFolder;

/// Learns the reward from demonstrations and agent experience, and answers for it.
#[derive(Debug, Parser)]
#[command(name = "goalward-proximity-service", version)]
struct Arguments {
    /// Folder of the run.
    #[arg(long)]
    run: PathBuf,
}

/// Runs the process.
pub fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let stop = Stop::at_end_of_input();
    process::run(|| crate::run(&RunFolder::new(arguments.run), &stop))
}
