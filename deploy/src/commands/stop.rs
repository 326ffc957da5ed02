//! `goalward stop`: ends a run's training as Ctrl-C in its terminal does.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use run::folder::RunFolder;
use run::holder::Holder;
use run::summary::Summary;
use rustix::process::{Signal, kill_process};
use terminal::print::print_line;

use crate::listening::how_to_resume;
use crate::lock;

/// How long a run may take to end: longer than its supervisor waits for the processes.
const PATIENCE: Duration = Duration::from_secs(120);

/// Time between two looks at the run.
const LOOK_EVERY: Duration = Duration::from_millis(50);

/// Flags of `goalward stop`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Folder of the run.
    run: PathBuf,
}

/// Interrupts the run's `goalward train` and waits until it has ended.
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let folder = RunFolder::new(&arguments.run);
    folder.config()?;
    let shown = arguments.run.display();
    let trainer = lock::trainer(&folder, "")?;
    let process = lock::process_here(&folder, &trainer)?;
    kill_process(process, Signal::INT).context("stopping the run")?;
    let begun = Instant::now();
    while folder.holder().is_some_and(|holder| holder.process == trainer.process) {
        if begun.elapsed() > PATIENCE {
            bail!("the run in {shown} has not ended within {} s", PATIENCE.as_secs());
        }
        std::thread::sleep(LOOK_EVERY);
    }
    if let Holder { process, failure: Some(failure), .. } = folder.last_holder()
        && process == trainer.process
    {
        bail!("the run in {shown} has failed: {failure}");
    }
    if matches!(Summary::of_run(&folder), Ok(Some(_))) {
        print_line("the run has finished");
        return Ok(());
    }
    print_line(&format!("stopped; continue it with\n  {}", how_to_resume(&folder)));
    Ok(())
}
