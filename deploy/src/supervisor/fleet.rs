//! All processes of a run: one learner, one proximity service, any number of actors.

use std::ffi::OsString;
use std::time::Duration;

use anyhow::Result;
use run::folder::RunFolder;

use super::actors::{Actors, Source};
use super::process::Process;
use super::signals::Signals;
use crate::programs::Program;

/// How long processes may take to stop when the learner is done.
const STOP_PATIENCE: Duration = Duration::from_secs(10);

/// The processes of a run.
pub(super) struct Fleet {
    pub(super) learner: Process,
    pub(super) service: Process,
    pub(super) actors: Actors,
}

impl Fleet {
    /// The processes of the run in `folder`, none of them started.
    pub(super) fn new(folder: &RunFolder, source: &Source) -> Self {
        let process = |program, name, verb: &[OsString]| {
            let run = [OsString::from("--run"), folder.path().into()];
            Process::new(folder, program, name, [verb, &run].concat())
        };
        Fleet {
            learner: process(Program::Learner, "learner", &[]),
            service: process(Program::ProximityService, "proximity-service", &["serve".into()]),
            actors: Actors::new(folder, source),
        }
    }

    /// Starts learner and service; the actors when they are looked after.
    pub(super) fn start(&mut self) -> Result<()> {
        self.start_core()?;
        self.actors.take_on();
        Ok(())
    }

    /// Starts proximity service and learner.
    pub(super) fn start_core(&mut self) -> Result<()> {
        self.service.start()?;
        self.learner.start()
    }

    /// Ends all processes: politely at first, by force after [`STOP_PATIENCE`] or when the user
    /// asks again.
    pub(super) async fn end(&mut self, signals: &mut Signals) -> Result<()> {
        self.processes().for_each(Process::ask_to_stop);
        let deadline = tokio::time::Instant::now() + STOP_PATIENCE;
        loop {
            for process in self.processes() {
                process.reap()?;
            }
            if !self.processes().any(|process| process.is_running()) {
                return Ok(());
            }
            tokio::select! {
                () = signals.child.next() => {}
                () = signals.stop.next() => break,
                () = tokio::time::sleep_until(deadline) => break,
            }
        }
        self.processes().try_for_each(Process::kill)
    }

    fn processes(&mut self) -> impl Iterator<Item = &mut Process> {
        [&mut self.learner, &mut self.service].into_iter().chain(self.actors.processes())
    }
}
