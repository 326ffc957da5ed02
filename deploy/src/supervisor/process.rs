//! One process of a run, which can be started more than once under the same name.

use std::ffi::OsString;
use std::fmt::Display;
use std::process::{ExitStatus, Stdio};
use std::time::Duration;

use anyhow::{Context, Result};
use run::folder::RunFolder;
use run::process::FINAL_CODE;
use tokio::time::Instant;

use super::signals::ChildSignals;
use crate::child::Child;
use crate::output::Output;
use crate::programs::Program;

/// A process of a run, alive or not.
pub(super) struct Process {
    name: String,
    program: Program,
    arguments: Vec<OsString>,
    output: Output,
    running: Option<Child>,
}

impl Process {
    /// Creates a process that is not started yet.
    pub(super) fn new(
        folder: &RunFolder,
        program: Program,
        name: &str,
        arguments: Vec<OsString>,
    ) -> Self {
        let output = Output::of(folder, name);
        Process { name: name.to_owned(), program, arguments, output, running: None }
    }

    pub(super) fn name(&self) -> &str {
        &self.name
    }

    pub(super) fn is_running(&self) -> bool {
        self.running.is_some()
    }

    /// Starts the process.
    pub(super) fn start(&mut self) -> Result<()> {
        let mut command = self.program.command()?;
        let command = command.args(&self.arguments).stdin(Stdio::piped());
        let started = Child::start(command, &self.output);
        self.running = Some(started.with_context(|| self.name.clone())?);
        Ok(())
    }

    /// Returns the exit status, once, if the process has ended since it was last started.
    pub(super) fn reap(&mut self) -> Result<Option<ExitStatus>> {
        let Some(running) = &mut self.running else { return Ok(None) };
        let status = running.reap().with_context(|| self.name.clone())?;
        if status.is_some() {
            self.running = None;
        }
        Ok(status)
    }

    /// Asks the process to stop.
    pub(super) fn ask_to_stop(&mut self) {
        if let Some(running) = &mut self.running {
            running.end_input();
        }
    }

    /// Kills the process.
    pub(super) fn kill(&mut self) -> Result<()> {
        if let Some(mut running) = self.running.take() {
            running.kill().with_context(|| self.name.clone())?;
        }
        Ok(())
    }

    /// Waits up to `patience` until the process has ended by itself; returns its exit status if it has.
    pub(super) async fn ended(
        &mut self,
        children: &mut ChildSignals,
        patience: Duration,
    ) -> Result<Option<ExitStatus>> {
        let deadline = Instant::now() + patience;
        loop {
            if let Some(status) = self.reap()? {
                return Ok(Some(status));
            }
            tokio::select! {
                () = children.next() => {}
                () = tokio::time::sleep_until(deadline) => return self.reap(),
            }
        }
    }

    /// Describes an end that the run survives: how it came about, and when the process is restarted.
    pub(super) fn ended_for_now(&self, how: &str, pause: Duration) -> String {
        let seconds = pause.as_secs_f64();
        format!(
            "{} ended ({how}); restarting it in {seconds} s; {}",
            self.name,
            self.output.last_lines()
        )
    }

    /// Returns the error that ends the whole run if the process has ended with [`FINAL_CODE`].
    pub(super) fn final_error(&self, status: ExitStatus) -> Option<anyhow::Error> {
        let is_final = status.code() == Some(i32::from(FINAL_CODE));
        is_final.then(|| self.give_up(status, "and would fail the same way again"))
    }

    /// Returns the error that ends the whole run: why this process cannot go on.
    pub(super) fn give_up(&self, how: impl Display, history: &str) -> anyhow::Error {
        anyhow::anyhow!("{} ended ({how}) {history}; {}", self.name, self.output.last_lines())
    }
}
