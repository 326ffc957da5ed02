//! Records demonstrations of an experiment, with an actor of its own, if they do not exist yet.

use std::path::PathBuf;
use std::process::ExitStatus;

use anyhow::{Result, bail};
use mcap_log::is_being_written;
use run::config::RunConfig;

use crate::child::Child;
use crate::demonstrations::{RECORDING, Recording};
use crate::headway;
use crate::output::Output;

/// Demonstrations that are being recorded.
pub(super) struct Recorder {
    /// The process that records them.
    pub(super) child: Child,
    output: Output,
    file: PathBuf,
}

impl Recorder {
    /// Starts the expert.
    pub(super) fn start(config: &RunConfig, file: PathBuf) -> Result<Recorder> {
        let output = Output::at(file.with_extension("txt"));
        let mut actor = Recording::for_run(config, &file).actor()?;
        let child = Child::start(&mut actor, &output)?;
        Ok(Recorder { child, output, file })
    }

    /// Describes the recording, with its progress as far as the actor has reported it.
    pub(super) fn words(&self) -> String {
        let end = self.output.end().unwrap_or_default();
        match end.lines().rev().find_map(headway::read) {
            Some(headway) => format!("{RECORDING} {} %", headway::percent(headway)),
            None => RECORDING.to_owned(),
        }
    }

    /// Checks that the expert `ended` well, or that another process was faster: then the file exists or is being
    /// written.
    ///
    /// # Errors
    /// When neither is the case, with the expert's last lines of output.
    pub(super) fn end(self, ended: ExitStatus) -> Result<()> {
        if ended.success() || self.file.exists() || is_being_written(&self.file) {
            return Ok(());
        }
        let (shown, words) = (self.file.display(), self.output.last_lines());
        bail!("recording {shown} failed ({ended}); {words}")
    }
}
