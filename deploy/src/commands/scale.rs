//! `goalward scale`: more or fewer actors for a run that is being trained.

use std::path::PathBuf;

use anyhow::Result;
use bus::MAX_ACTORS;
use run::folder::RunFolder;

use crate::machine::Machine;
use crate::supervisor;
use terminal::print::print_line;
use terminal::refusal::wrong_usage;

/// Flags of `goalward scale`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Folder of the run.
    run: PathBuf,
    /// Actor processes from now on.
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..=MAX_ACTORS as u64))]
    actors: u64,
}

/// Tells the supervisor of a run how many actors there are to be.
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let Arguments { run, actors } = arguments;
    let folder = RunFolder::new(run);
    folder.config()?;
    if !folder.is_trained() {
        return Err(wrong_usage(format!(
            "nobody trains the run in {}; --resume takes --actors {actors}",
            run.display()
        )));
    }
    Machine::here().require_room_for_actors(*actors)?;
    supervisor::want_actors(&folder, *actors)?;
    print_line(&format!("actors: {actors}"));
    Ok(())
}
