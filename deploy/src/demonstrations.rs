//! The demonstrations of a run: a file of the user's is checked before anything is begun, one that
//! is not given is recorded by the task's expert.

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

/// What an expert does, as its user is told.
pub(crate) const RECORDING: &str = "recording demonstrations";

/// Demonstrations to be recorded.
pub(crate) struct Recording<'a> {
    pub(crate) task: &'a Task,
    pub(crate) episodes: u64,
    pub(crate) setting: Setting,
    /// A run whose policy is the expert; without it the task's own.
    pub(crate) policy: Option<&'a Path>,
    pub(crate) seed: u64,
    pub(crate) file: &'a Path,
    /// Whether they may take the place of a file that is there.
    pub(crate) force: bool,
}

impl<'a> Recording<'a> {
    /// What a run learns from unless it is given a file.
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

    /// An actor that records them, and gives up when its input ends; where its output goes is the caller's
    /// to say.
    ///
    /// # Errors
    /// When the program is not there.
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

    /// Has them recorded by an [`actor`](Self::actor), and shows on `line` how far it is. Gives how it
    /// ended; none if the user has stopped it.
    ///
    /// # Errors
    /// When it cannot start.
    pub(crate) fn record(
        &self,
        actor: &mut Command,
        line: StatusLine,
    ) -> Result<Option<ExitStatus>> {
        let ended = programs::run_unless_stopped(actor, RECORDING, line)?;
        if ended.is_none() {
            // One that did not stop in time was killed and has left it.
            mcap_log::remove_abandoned(self.file, Kind::Demonstrations)?;
        }
        Ok(ended)
    }
}

/// Has demonstrations recorded into a run's folder; returns false if the user has stopped it.
///
/// # Errors
/// When the expert fails, with its last words; of wrong usage, when what it shows is too little.
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

/// Checks that a file has the demonstrations a run is to learn from.
///
/// # Errors
/// Of wrong usage, when it is missing, damaged, of another task, shape or setting, or too short.
pub(crate) fn check(file: &Path, config: &RunConfig) -> Result<()> {
    run::demonstrations::of_file(file, config).map_err(Refusal::usage)?;
    Ok(())
}

/// A configuration with what its file of demonstrations says of them, where the user does not.
///
/// # Errors
/// Of wrong usage, when the file cannot be read or is of another task.
pub(crate) fn adopt(config: RunConfig, settings: &[String]) -> Result<RunConfig> {
    Ok(run::demonstrations::adopt(config, settings).map_err(Refusal::usage)?)
}

/// What is to be said of a file that does not tell how its demonstrations were recorded.
///
/// # Errors
/// As [`adopt`].
pub(crate) fn remark(file: &Path, task: &Task) -> Result<Option<String>> {
    let tells = run::demonstrations::tells_setting(file, task);
    let remark = || {
        format!(
            "{} does not say how it was recorded: taken as recorded in the agent's environment, \
             actions as they are",
            file.display()
        )
    };
    Ok((!tells.map_err(Refusal::usage)?).then(remark))
}
