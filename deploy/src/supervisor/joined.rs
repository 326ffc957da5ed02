//! Supervises actors that take part in a run on another machine.

use std::ffi::OsString;
use std::time::Duration;

use anyhow::Result;
use bus::BusAddress;
use run::actors_wanted::ActorsWanted;
use run::folder::RunFolder;

use super::actors::{Actors, Source};
use super::bus_folder::BusFolder;
use super::gateway::Told;
use super::process::Process;
use super::signals::Signals;
use super::{Outcome, clear_bus, fleet};
use crate::programs::Program;
use crate::progress::ProgressView;

/// Time between two checks of the processes if no signal arrives.
const TICK: Duration = Duration::from_millis(250);

/// A machine that takes part in a run on another one.
pub(crate) struct Joining {
    /// Folder that was laid out for its actors.
    pub(crate) folder: RunFolder,
    /// Arguments of the gateway.
    pub(crate) gateway: Vec<OsString>,
    /// The actors to start.
    pub(crate) source: Source,
}

/// Takes part until the run is over or the user stops it.
///
/// # Errors
/// When the gateway is refused or hears nothing from the run for too long, or when all actors die too often. No process
/// is left behind.
pub(crate) async fn take_part(joining: &Joining, view: &ProgressView) -> Result<Outcome> {
    let Joining { folder, gateway, source } = joining;
    let mut signals = Signals::listen()?;
    let address = BusAddress::for_start(folder.path())?;
    let mut gateway = Process::new(folder, Program::Gateway, "gateway", gateway.clone());
    let mut actors = Actors::new(folder, source);
    let bus = BusFolder::of(&address);
    gateway.start()?;
    actors.take_on();
    let outcome = watch(folder, bus, &mut gateway, &mut actors, &mut signals, view).await;
    let processes = actors.processes().chain([&mut gateway]).collect();
    let ended = fleet::end(processes, &mut signals).await;
    clear_bus(ended, &address, view).await;
    outcome
}

async fn watch(
    folder: &RunFolder,
    mut bus: BusFolder,
    gateway: &mut Process,
    actors: &mut Actors,
    signals: &mut Signals,
    view: &ProgressView,
) -> Result<Outcome> {
    let (mut wanted, mut told) = (ActorsWanted::here(folder), Told::default());
    loop {
        if let Some(status) = gateway.reap()? {
            if status.success() {
                return Ok(Outcome::Finished);
            }
            return Err(gateway.give_up(status, "and this machine has left the run"));
        }
        bus.check()?;
        told.look(folder, view);
        actors.follow(&mut wanted, true, view);
        actors.look_after(view)?;
        tokio::select! {
            () = signals.stop.next() => return Ok(Outcome::Stopped),
            () = signals.child.next() => {}
            () = tokio::time::sleep(TICK) => {}
        }
    }
}
