//! One process of a run, which can be started more than once under the same name.

use std::ffi::OsString;
use std::fmt::Display;
use std::os::unix::process::CommandExt;
use std::process::{Child, ChildStdin, ExitStatus, Stdio};
use std::time::Duration;

use anyhow::{Context, Result};
use run::folder::RunFolder;
use tokio::time::Instant;

use super::signals::ChildSignals;
use crate::output::Output;
use crate::programs::Program;

/// A process of a run, alive or not.
pub(super) struct Process {
    name: String,
    program: Program,
    arguments: Vec<OsString>,
    output: Output,
    running: Option<Running>,
}

struct Running {
    child: Child,
    /// Its end is the process's sign to stop; it also ends when the supervisor dies.
    input: Option<ChildStdin>,
}

impl Process {
    /// A process that is not started yet.
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

    /// Starts it, in a process group of its own: Ctrl-C is for the supervisor alone.
    pub(super) fn start(&mut self) -> Result<()> {
        let output = self.output.open()?;
        let same_output = output.try_clone().context("sharing the output of a process")?;
        let mut child = self
            .program
            .command()?
            .args(&self.arguments)
            .env("NO_COLOR", "1")
            .process_group(0)
            .stdin(Stdio::piped())
            .stdout(output)
            .stderr(same_output)
            .spawn()
            .with_context(|| format!("starting {}", self.name))?;
        let input = child.stdin.take();
        self.running = Some(Running { child, input });
        Ok(())
    }

    /// How it ended, if it has since it was last started; told once.
    pub(super) fn reap(&mut self) -> Result<Option<ExitStatus>> {
        let Some(running) = &mut self.running else { return Ok(None) };
        let waited = running.child.try_wait();
        let status = waited.with_context(|| format!("waiting for {}", self.name))?;
        if status.is_some() {
            self.running = None;
        }
        Ok(status)
    }

    /// Asks it to stop.
    pub(super) fn ask_to_stop(&mut self) {
        if let Some(running) = &mut self.running {
            running.input = None;
        }
    }

    /// Ends it at once.
    pub(super) fn kill(&mut self) -> Result<()> {
        if let Some(mut running) = self.running.take() {
            let ended = running.child.kill().and_then(|()| running.child.wait());
            ended.with_context(|| format!("killing {}", self.name))?;
        }
        Ok(())
    }

    /// Waits until it has ended by itself, but not longer than `patience`.
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

    /// Words for the end of the whole run: why this process cannot go on.
    pub(super) fn give_up(&self, how: impl Display, history: &str) -> anyhow::Error {
        anyhow::anyhow!("{} ended ({how}) {history}; {}", self.name, self.output.last_lines())
    }
}
