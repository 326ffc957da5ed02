//! The gateway of a run that other machines can join. It is restarted when it dies, and its death never ends the run.

use std::time::{Duration, Instant};

use anyhow::Result;
use run::folder::RunFolder;
use run::hosts::{Host, Hosts};

use super::actors::Source;
use super::process::Process;
use super::restart::Deaths;
use crate::programs::Program;
use crate::progress::ProgressView;

/// Pause before a gateway that has died is restarted.
const PAUSE: Duration = Duration::from_millis(500);

/// Time between two looks at the machines that take part.
const LOOK_AT_HOSTS: Duration = Duration::from_millis(500);

/// The gateway of a run.
pub(super) struct Gateway {
    pub(super) process: Process,
    deaths: Deaths,
    /// When the gateway is restarted, if it has ended.
    start_at: Option<Instant>,
    told: Told,
}

/// The machines that the user was told about. A machine that takes part in a run tells of itself.
#[derive(Default)]
pub(super) struct Told {
    looked: Option<Instant>,
    hosts: Hosts,
}

impl Gateway {
    /// Returns the gateway of the run in `folder`, not started; `None` if no machine may join.
    pub(super) fn of(folder: &RunFolder, source: &Source) -> Option<Gateway> {
        let Source::Environments { listening, .. } = source else { return None };
        let arguments = listening.as_ref()?.arguments(folder);
        let process = Process::new(folder, Program::Gateway, "gateway", arguments);
        let (deaths, told) = (Deaths::default(), Told::default());
        Some(Gateway { process, deaths, start_at: None, told })
    }

    /// Restarts the gateway when it has died, and tells the user which machines come and go. Hosts reconnect by
    /// themselves.
    ///
    /// # Errors
    /// When the system cannot say how the gateway ended.
    pub(super) fn look_after(&mut self, folder: &RunFolder, view: &ProgressView) -> Result<()> {
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
        if self.process.is_running() {
            self.told.look(folder, view);
        }
        Ok(())
    }
}

impl Told {
    /// Says which machines have joined, left or been expelled since the last look.
    pub(super) fn look(&mut self, folder: &RunFolder, view: &ProgressView) {
        if self.looked.is_some_and(|looked| looked.elapsed() < LOOK_AT_HOSTS) {
            return;
        }
        self.looked = Some(Instant::now());
        let hosts = Hosts::of_run(folder);
        let is_among =
            |host: &Host, hosts: &Hosts| hosts.present.iter().any(|other| other.name == host.name);
        for host in hosts.present.iter().filter(|host| !is_among(host, &self.hosts)) {
            view.note(&format!("{} joined the run{}", host.name, host.other_build()));
        }
        for host in self.hosts.present.iter().filter(|host| !is_among(host, &hosts)) {
            view.note(&format!("{} left the run", host.name));
        }
        for expelled in hosts.expelled.iter().filter(|one| !self.hosts.expelled.contains(one)) {
            view.note(&format!("{} is expelled: {}", expelled.name, expelled.why));
        }
        if let (None, Some(why)) = (&self.hosts.unaudited, &hosts.unaudited) {
            view.note(&format!(
                "an episode of a host cannot be audited and is not published ({why}); output/gateway.log \
                 has what follows"
            ));
        }
        self.hosts = hosts;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::output::Output;

    #[test]
    fn the_user_is_told_once_that_audits_fail() {
        let directory = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(directory.path());
        std::fs::create_dir(folder.output()).unwrap();
        let remarks = Output::of(&folder, "supervisor");
        let (view, mut told) = (ProgressView::kept_in(remarks.clone()), Told::default());
        let unaudited = Some("the auditor has ended".to_owned());
        Hosts { unaudited, ..Hosts::default() }.write(&folder).unwrap();
        for _ in 0..2 {
            told.looked = None;
            told.look(&folder, &view);
        }
        let said = remarks.end().unwrap();
        assert_eq!(said.matches("(the auditor has ended)").count(), 1, "{said}");
    }
}
