//! The demonstrations of a run. A file that the user gives is checked before anything is begun; otherwise the task's
//! expert records them.

use std::path::Path;
use std::process::{Command, ExitStatus, Stdio};

use anyhow::{Result, bail};
use mcap_log::Kind;
use protocol::setting::Setting;
use protocol::task::Task;
use run::config::RunConfig;
use run::folder::RunFolder;

use crate::output::Output;
use crate::programs::{self, Program};
use terminal::refusal::Refusal;
use terminal::status_line::StatusLine;

/// Words of the status line while an expert records.
pub(crate) const RECORDING: &str = "recording demonstrations";

/// Demonstrations to be recorded.
pub(crate) struct Recording<'a> {
    pub(crate) task: &'a Task,
    pub(crate) episodes: u64,
    pub(crate) setting: Setting,
    /// Run whose policy is the expert; if `None`, the task's own expert.
    pub(crate) policy: Option<&'a Path>,
    pub(crate) seed: u64,
    pub(crate) file: &'a Path,
    /// Whether an existing file may be replaced.
    pub(crate) force: bool,
}

impl<'a> Recording<'a> {
    /// Returns the recording that a run learns from unless the user gives it a file.
    pub(crate) fn for_run(config: &'a RunConfig, file: &'a Path) -> Self {
        Recording {
            task: &config.task,
            episodes: config.demonstrations.episodes,
            setting: config.demonstration_setting(),
            policy: None,
            seed: config.seed,
            file,
            force: false,
        }
    }

    /// Returns the command of an actor that records them and gives up when its standard input ends. The caller decides
    /// where the actor's output goes.
    ///
    /// # Errors
    /// When the actor's program is missing.
    pub(crate) fn actor(&self) -> Result<Command> {
        let Recording { task, episodes, setting, policy, seed, file, force } = self;
        let mut actor = Program::acting_in(task).command()?;
        actor
            .args(["demonstrate", &task.name])
            .args(["--episodes", &episodes.to_string()])
            .args(["--setting", &serde_json::to_string(setting)?])
            .args(["--seed", &seed.to_string()])
            .arg("--out")
            .arg(file)
            .args(force.then_some("--force"))
            .stdin(Stdio::piped());
        if let Some(run) = policy {
            actor.arg("--policy").arg(run);
        }
        Ok(actor)
    }

    /// Records them with an [`actor`](Self::actor) and shows its progress on `line`. Returns the exit status, or `None`
    /// if the user has stopped it.
    ///
    /// # Errors
    /// When the actor cannot start.
    pub(crate) fn record(
        &self,
        actor: &mut Command,
        line: StatusLine,
    ) -> Result<Option<ExitStatus>> {
        let ended = programs::run_unless_stopped(actor, RECORDING, line)?;
        if ended.is_none() {
            // An actor that did not stop in time was killed and has left an unfinished file.
            mcap_log::remove_abandoned(self.file, Kind::Demonstrations)?;
        }
        Ok(ended)
    }
}

/// Records demonstrations into a run's folder; returns false if the user has stopped it.
///
/// # Errors
/// When the expert fails, with its last lines of output; wrong usage, when its demonstrations are too few.
pub(crate) fn record_for_run(folder: &RunFolder, config: &RunConfig) -> Result<bool> {
    let file = folder.demonstrations_file();
    let output = Output::of(folder, "demonstrations");
    let recording = Recording::for_run(config, &file);
    let mut actor = recording.actor()?;
    actor.env("NO_COLOR", "1").stderr(output.open()?);
    match recording.record(&mut actor, StatusLine::new())? {
        Some(status) if !status.success() => {
            bail!("recording demonstrations failed ({status}); {}", output.last_lines())
        }
        Some(_) => check(&file, config).map(|()| true),
        None => Ok(false),
    }
}

/// Checks that a file has the demonstrations that a run is to learn from.
///
/// # Errors
/// Wrong usage, when the file is missing, damaged, too short, or of another task, shape or setting.
pub(crate) fn check(file: &Path, config: &RunConfig) -> Result<()> {
    run::demonstrations::of_file(file, config).map_err(Refusal::usage)?;
    Ok(())
}

/// Returns the configuration with what its file of demonstrations records about them, except where the user's
/// `settings` say otherwise.
///
/// # Errors
/// Wrong usage, when the file cannot be read or is of another task.
pub(crate) fn adopt(config: RunConfig, settings: &[String]) -> Result<RunConfig> {
    Ok(run::demonstrations::adopt(config, settings).map_err(Refusal::usage)?)
}

/// Returns a remark about a file that does not say how its demonstrations were recorded.
///
/// # Errors
/// As [`adopt`].
pub(crate) fn remark(file: &Path, task: &Task) -> Result<Option<String>> {
    let tells = run::demonstrations::tells_setting(file, task);
    let remark = || {
        format!(
            "{} does not say how it was recorded: assuming the agent's environment and unscaled \
             actions",
            file.display()
        )
    };
    Ok((!tells.map_err(Refusal::usage)?).then(remark))
}
