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

/// The machines that the user was told about.
#[derive(Default)]
struct Told {
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
    fn look(&mut self, folder: &RunFolder, view: &ProgressView) {
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
        self.hosts = hosts;
    }
}
