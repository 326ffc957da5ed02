//! A process that `goalward` starts and looks after: it has a process group of its own, so that Ctrl-C is
//! for `goalward` alone, and what it prints is appended to a file.

use std::os::unix::process::CommandExt;
use std::process::{self, ChildStdin, Command, ExitStatus};

use anyhow::{Context, Result};
use rustix::process::{Pid, Signal, kill_process};

use crate::output::Output;

/// A process that was started.
pub(crate) struct Child {
    child: process::Child,
    /// Its end is the sign to stop, if the process takes one; it also ends with `goalward`.
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

    /// How it ended, if it has.
    ///
    /// # Errors
    /// When the system does not say.
    pub(crate) fn reap(&mut self) -> Result<Option<ExitStatus>> {
        self.child.try_wait().context("waiting for a process")
    }

    /// Ends its input, which asks it to stop; false if it had none or has been asked before.
    pub(crate) fn end_input(&mut self) -> bool {
        self.input.take().is_some()
    }

    /// Interrupts it, as Ctrl-C does.
    pub(crate) fn interrupt(&mut self) {
        // It may have ended by itself, which is as well.
        kill_process(Pid::from_child(&self.child), Signal::INT).ok();
    }

    /// Ends it at once.
    ///
    /// # Errors
    /// When the system refuses.
    pub(crate) fn kill(&mut self) -> Result<()> {
        let ended = self.child.kill().and_then(|()| self.child.wait().map(drop));
        ended.context("killing a process")
    }
}
