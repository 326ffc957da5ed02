//! All processes of a run: one learner, one proximity service, any number of actors.

use std::ffi::OsString;
use std::time::Duration;

use anyhow::Result;
use run::folder::RunFolder;

use super::actors::{Actors, Source};
use super::gateway::Gateway;
use super::process::Process;
use super::signals::Signals;
use crate::programs::Program;

/// Longest time that processes may take to stop.
const STOP_PATIENCE: Duration = Duration::from_secs(10);

/// The processes of a run.
pub(super) struct Fleet {
    pub(super) learner: Process,
    pub(super) service: Process,
    pub(super) actors: Actors,
    /// Lets actors on other machines join, if they may.
    pub(super) gateway: Option<Gateway>,
}

impl Fleet {
    /// Creates the processes of the run in `folder`, none of them started.
    pub(super) fn new(folder: &RunFolder, source: &Source) -> Self {
        let process = |program, name, verb: &[OsString]| {
            let run = [OsString::from("--run"), folder.path().into()];
            Process::new(folder, program, name, [verb, &run].concat())
        };
        Fleet {
            learner: process(Program::Learner, "learner", &[]),
            service: process(Program::ProximityService, "proximity-service", &["serve".into()]),
            actors: Actors::new(folder, source),
            gateway: Gateway::of(folder, source),
        }
    }

    /// Starts learner, service and gateway. The actors start when they are looked after.
    pub(super) fn start(&mut self) -> Result<()> {
        self.start_core()?;
        if let Some(gateway) = &mut self.gateway {
            gateway.process.start()?;
        }
        self.actors.take_on();
        Ok(())
    }

    /// Starts proximity service and learner.
    pub(super) fn start_core(&mut self) -> Result<()> {
        self.service.start()?;
        self.learner.start()
    }

    /// Ends all processes.
    pub(super) async fn end(&mut self, signals: &mut Signals) -> Result<()> {
        end(self.processes().collect(), signals).await
    }

    fn processes(&mut self) -> impl Iterator<Item = &mut Process> {
        let gateway = self.gateway.iter_mut().map(|gateway| &mut gateway.process);
        [&mut self.learner, &mut self.service]
            .into_iter()
            .chain(self.actors.processes())
            .chain(gateway)
    }
}

/// Ends processes: politely at first, by force after [`STOP_PATIENCE`] or when the user asks again.
pub(super) async fn end(mut processes: Vec<&mut Process>, signals: &mut Signals) -> Result<()> {
    processes.iter_mut().for_each(|process| process.ask_to_stop());
    let deadline = tokio::time::Instant::now() + STOP_PATIENCE;
    loop {
        for process in &mut processes {
            process.reap()?;
        }
        if !processes.iter().any(|process| process.is_running()) {
            return Ok(());
        }
        tokio::select! {
            () = signals.child.next() => {}
            () = signals.stop.next() => break,
            () = tokio::time::sleep_until(deadline) => break,
        }
    }
    // All are killed, even if one cannot be.
    let killed: Vec<_> = processes.into_iter().map(Process::kill).collect();
    killed.into_iter().collect()
}
