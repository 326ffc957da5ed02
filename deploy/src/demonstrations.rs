//! The demonstrations of a run: a file of the user's is checked before anything is begun, one that
//! is not given is recorded by the task's expert.

use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail};
use protocol::config::RunConfig;
use protocol::log::{FileReader, Kind};
use protocol::run::RunFolder;
use protocol::setting::Setting;
use protocol::task::Task;

use crate::output::Output;
use crate::programs::Program;
use crate::refusal::{Refusal, wrong_usage};

/// Demonstrations to be recorded.
pub(crate) struct Recording<'a> {
    pub(crate) task: Task,
    pub(crate) episodes: u64,
    pub(crate) setting: Setting,
    /// A run whose policy is the expert; without it the task's own.
    pub(crate) policy: Option<&'a Path>,
    pub(crate) seed: u64,
    pub(crate) file: &'a Path,
}

impl<'a> Recording<'a> {
    /// What a run learns from unless it is given a file.
    pub(crate) fn for_run(config: &RunConfig, file: &'a Path) -> Self {
        Recording {
            task: config.task,
            episodes: config.demonstrations.episodes,
            setting: config.demonstration_setting(),
            policy: None,
            seed: config.seed,
            file,
        }
    }

    /// An actor that records them; where its output goes is the caller's to say.
    ///
    /// # Errors
    /// When the program is not there.
    pub(crate) fn actor(&self) -> Result<Command> {
        let Recording { task, episodes, setting, policy, seed, file } = self;
        let mut actor = Program::Actor.command()?;
        actor
            .args(["demonstrate", task.name()])
            .args(["--episodes", &episodes.to_string()])
            .args(["--setting", &serde_json::to_string(setting)?])
            .args(["--seed", &seed.to_string()])
            .arg("--out")
            .arg(file)
            .stdin(Stdio::null());
        if let Some(run) = policy {
            actor.arg("--policy").arg(run);
        }
        Ok(actor)
    }
}

/// Has demonstrations recorded into a run's folder.
///
/// # Errors
/// When the expert fails; with its last words.
pub(crate) fn record_for_run(folder: &RunFolder, config: &RunConfig) -> Result<()> {
    let file = folder.demonstrations_file();
    // What an interrupted start left; a whole file has no such ending.
    let unfinished = file.with_extension("mcap.active");
    if unfinished.exists() {
        std::fs::remove_file(&unfinished)
            .with_context(|| format!("removing {}", unfinished.display()))?;
    }
    let mut actor = Recording::for_run(config, &file).actor()?;
    let output = Output::of(folder, "demonstrations");
    actor.env("NO_COLOR", "1").stdout(output.open()?).stderr(output.open()?);
    let status = actor.status().context("starting the expert")?;
    if !status.success() {
        bail!("recording demonstrations failed ({status}); {}", output.last_lines());
    }
    Ok(())
}

/// Checks that a file has the demonstrations a run needs.
///
/// # Errors
/// Of wrong usage, when it is missing, damaged, of another task or shape, or too short.
pub(crate) fn check(file: &Path, config: &RunConfig) -> Result<()> {
    let shown = file.display();
    let reader = FileReader::open(file).map_err(Refusal::usage)?;
    let metadata = reader.metadata();
    if metadata.kind != Kind::Demonstrations {
        return Err(wrong_usage(format!(
            "{shown}: expected demonstrations, found the log of a run"
        )));
    }
    let (expected, found) = (config.task.name(), metadata.get("task").unwrap_or("none"));
    if found != expected {
        return Err(wrong_usage(format!(
            "{shown}: expected demonstrations of the task {expected}, found {found}"
        )));
    }
    let (spec, with_actions) = (config.task.spec(), config.needs_expert_actions());
    let found = protocol::demonstrations::read(file, &spec, with_actions);
    let episodes = found.map_err(Refusal::usage)?.len() as u64;
    let wanted = config.demonstrations.episodes;
    if episodes < wanted {
        return Err(wrong_usage(format!(
            "{shown}: expected at least {wanted} demonstrations, found {episodes} (fewer are \
             asked for with --set demonstrations.episodes={episodes})"
        )));
    }
    Ok(())
}
