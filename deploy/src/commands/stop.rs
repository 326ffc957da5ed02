//! `goalward stop`: ends a run's training as Ctrl-C in its terminal does.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use bus::BusAddress;
use run::folder::RunFolder;
use run::summary::Summary;
use rustix::process::{Pid, Signal, kill_process};
use terminal::print::print_line;
use terminal::refusal::wrong_usage;

use crate::listening::how_to_resume;
use crate::processes::Processes;

/// How long a run may take to end.
const PATIENCE: Duration = Duration::from_secs(60);

/// Time between two looks at the run.
const LOOK_EVERY: Duration = Duration::from_millis(50);

/// Flags of `goalward stop`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Folder of the run.
    run: PathBuf,
}

/// Interrupts the run's supervisor and waits until all its processes are gone.
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let folder = RunFolder::new(&arguments.run);
    folder.config()?;
    let shown = arguments.run.display();
    if !folder.is_trained() {
        return Err(wrong_usage(format!(
            "{shown}: expected a run that is training, found one that is not"
        )));
    }
    kill_process(supervisor(&folder)?, Signal::INT).context("stopping the supervisor")?;
    let begun = Instant::now();
    while folder.is_trained() {
        if begun.elapsed() > PATIENCE {
            bail!("the run in {shown} has not ended within {} s", PATIENCE.as_secs());
        }
        std::thread::sleep(LOOK_EVERY);
    }
    if matches!(Summary::of_run(&folder), Ok(Some(_))) {
        print_line("the run has finished");
        return Ok(());
    }
    print_line(&format!("stopped; continue it with\n  {}", how_to_resume(&folder)));
    Ok(())
}

fn supervisor(folder: &RunFolder) -> Result<Pid> {
    let address = BusAddress::if_started(folder.path())?;
    let found = address.map(|address| Processes::on(&address)).transpose()?;
    let id = found.and_then(|processes| processes.supervisor());
    let id = id.and_then(|id| Pid::from_raw(i32::try_from(id).ok()?));
    id.with_context(|| {
        let shown = folder.path().display();
        format!(
            "expected the supervisor of the run in {shown} on its bus, found none: it is starting, \
             or in another container"
        )
    })
}
