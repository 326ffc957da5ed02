//! The gateway of a run that listens for other machines: started again when it dies, and never the end of
//! the run.

use std::time::{Duration, Instant};

use anyhow::Result;
use run::folder::RunFolder;

use super::actors::Source;
use super::process::Process;
use super::restart::ActorDeaths;
use crate::programs::Program;
use crate::progress::ProgressView;

/// How long one that has died is left alone.
const PAUSE: Duration = Duration::from_millis(500);

/// The gateway of a run.
pub(super) struct Gateway {
    pub(super) process: Process,
    deaths: ActorDeaths,
    /// When it is started again, if it has ended.
    start_at: Option<Instant>,
}

impl Gateway {
    /// That of the run in `folder`, not started; none if nobody may join.
    pub(super) fn of(folder: &RunFolder, source: &Source) -> Option<Gateway> {
        let Source::Environments { listening, .. } = source else { return None };
        let arguments = listening.as_ref()?.arguments(folder);
        let process = Process::new(folder, Program::Gateway, "gateway", arguments);
        Some(Gateway { process, deaths: ActorDeaths::default(), start_at: None })
    }

    /// Starts it again when it has died: hosts come back by themselves.
    ///
    /// # Errors
    /// When the system does not say how it ended.
    pub(super) fn look_after(&mut self, view: &ProgressView) -> Result<()> {
        let mut failure = self.process.reap()?.map(|status| status.to_string());
        if self.start_at.is_some_and(|at| at <= Instant::now()) {
            self.start_at = None;
            failure = self.process.start().err().map(|error| format!("{error:#}"));
        }
        if let Some(how) = failure {
            let now = Instant::now();
            let pause = self.deaths.note(now).unwrap_or(PAUSE);
            self.start_at = Some(now + pause);
            view.note(&self.process.ended_for_now(&how, pause));
        }
        Ok(())
    }
}
