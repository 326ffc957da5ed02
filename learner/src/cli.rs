//! The command line of `goalward-learner`. Users type `goalward train`, which starts it.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser;
use run::diagnostics::Diagnostics;
use run::folder::RunFolder;
use run::process::{self, Stop};

/// Turns trajectories and their scores into policy weights.
#[derive(Debug, Parser)]
#[command(name = "goalward-learner", version = protocol::build::version())]
struct Arguments {
    /// Folder of the run; a run with a checkpoint is continued.
    #[arg(long)]
    run: PathBuf,
}

/// Runs the learner process.
pub fn main() -> ExitCode {
    let arguments = Arguments::parse();
    process::run(Diagnostics::of_service(), || {
        crate::run(&RunFolder::new(arguments.run), &Stop::at_end_of_input()?)
    })
}
