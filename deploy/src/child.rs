//! A process that `goalward` starts and supervises. It has a process group of its own, so that Ctrl-C reaches
//! `goalward` alone, and its output is appended to a file.

use std::os::unix::process::CommandExt;
use std::process::{self, ChildStdin, Command, ExitStatus};

use anyhow::{Context, Result};
use rustix::process::{Pid, Signal, kill_process};

use crate::output::Output;

/// A started process.
pub(crate) struct Child {
    child: process::Child,
    /// The process's standard input, if it is a pipe. Closing it asks the process to stop; it also closes when
    /// `goalward` ends.
    input: Option<ChildStdin>,
}

impl Child {
    /// Starts a process that prints to `output`.
    ///
    /// # Errors
    /// When the file cannot be opened, or the program cannot be started.
    pub(crate) fn start(command: &mut Command, output: &Output) -> Result<Child> {
        let stdout = output.open()?;
        let stderr = stdout.try_clone().context("sharing the output of a process")?;
        let command = command.process_group(0).env("NO_COLOR", "1").stdout(stdout).stderr(stderr);
        tracing::info!("starting {command:?}");
        let mut child = command.spawn().context("starting a process")?;
        let input = child.stdin.take();
        Ok(Child { child, input })
    }

    /// Returns the exit status if the process has ended.
    ///
    /// # Errors
    /// When the system cannot say.
    pub(crate) fn reap(&mut self) -> Result<Option<ExitStatus>> {
        self.child.try_wait().context("waiting for a process")
    }

    /// Closes the standard input, which asks the process to stop. Returns false if there was no open pipe.
    pub(crate) fn end_input(&mut self) -> bool {
        self.input.take().is_some()
    }

    /// Interrupts the process, as Ctrl-C does.
    pub(crate) fn interrupt(&mut self) {
        // An error means that the process has already ended.
        kill_process(Pid::from_child(&self.child), Signal::INT).ok();
    }

    /// Kills the process and waits for its end.
    ///
    /// # Errors
    /// When the system refuses.
    pub(crate) fn kill(&mut self) -> Result<()> {
        let ended = self.child.kill().and_then(|()| self.child.wait().map(drop));
        ended.context("killing a process")
    }
}
