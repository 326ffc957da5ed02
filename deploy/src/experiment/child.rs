//! Processes of an experiment: `goalward train` for a run, and before it an actor for its
//! demonstrations, where nobody has recorded them yet.

use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::{Child, ChildStdin, Command, ExitStatus, Stdio};

use anyhow::{Context, Result, bail};
use run::config::{ResourceConfig, RunConfig};
use run::folder::RunFolder;
use rustix::process::{Pid, Signal, kill_process};

use super::archive::Archive;
use super::planned_run::PlannedRun;
use crate::demonstrations::{RECORDING, Recording};
use crate::output::Output;
use crate::progress::{LineProgress, read_line};
use crate::{headway, plan};

/// A lease must not be handed out again because other runs keep an actor waiting, milliseconds.
const PATIENT_LEASE_TIMEOUT_MS: u64 = 120_000;

/// A process that was started.
pub(super) struct Running {
    child: Child,
    /// Its end is the sign to stop, if the process takes one.
    input: Option<ChildStdin>,
    output: Output,
}

impl Running {
    fn start(command: &mut Command, output: Output) -> Result<Running> {
        let (stdout, stderr) = (output.open()?, output.open()?);
        // In a group of its own: Ctrl-C is for the experiment alone.
        let command = command.process_group(0).env("NO_COLOR", "1");
        let mut child =
            command.stdout(stdout).stderr(stderr).spawn().context("starting a process")?;
        let input = child.stdin.take();
        Ok(Running { child, input, output })
    }

    /// How it ended, if it has.
    pub(super) fn reap(&mut self) -> Result<Option<ExitStatus>> {
        self.child.try_wait().context("waiting for a process")
    }

    /// Asks it to stop; if it has been asked before, it is to stop at once.
    pub(super) fn interrupt(&mut self) {
        if self.input.take().is_some() {
            return;
        }
        // It may have ended by itself, which is as well.
        kill_process(Pid::from_child(&self.child), Signal::INT).ok();
    }

    /// What it printed.
    pub(super) fn output(&self) -> &Output {
        &self.output
    }

    /// How far the run is, as far as it has said so.
    pub(super) fn standing(&self) -> Option<LineProgress> {
        self.output.end().ok()?.lines().rev().find_map(read_line)
    }
}

/// What is to be trained, and where.
pub(super) struct Training {
    /// The run.
    pub(super) run: PlannedRun,
    /// Its name, that of its folder.
    pub(super) name: String,
    /// Its folder.
    pub(super) folder: RunFolder,
    /// The demonstrations that the experiment gives it.
    pub(super) demonstrations: Option<PathBuf>,
}

impl Training {
    /// A run of a plan.
    pub(super) fn of(run: &PlannedRun, archive: &mut Archive) -> Training {
        let config = &run.config;
        let given = config.imitates() && config.demonstrations.file.is_none();
        Training {
            name: archive.name_of(run),
            folder: archive.folder_of(run),
            demonstrations: given.then(|| archive.demonstrations_of(config)),
            run: run.clone(),
        }
    }

    /// Whether another `goalward train` has the run right now.
    pub(super) fn is_elsewhere(&self) -> bool {
        self.folder.path().is_dir() && plan::lock(&self.folder).is_err()
    }

    /// The demonstrations that are to be recorded before it starts.
    pub(super) fn missing_demonstrations(&self) -> Option<PathBuf> {
        self.demonstrations.clone().filter(|file| !file.exists())
    }

    /// Starts `goalward train`, or goes on with it where it has begun. Where others run beside it,
    /// each gets one core.
    pub(super) fn start(&self, is_alone: bool, other_build: bool) -> Result<Running> {
        let goalward = std::env::current_exe().context("finding goalward itself")?;
        let mut command = Command::new(goalward);
        command.arg("train").stdin(Stdio::null());
        if self.folder.config_file().exists() {
            command.arg("--resume").args(other_build.then_some("--other-build"));
        } else {
            command.arg(&self.run.task);
            for setting in &self.run.settings {
                command.args(["--set", setting]);
            }
            if let Some(file) = &self.demonstrations {
                command.arg("--demonstrations").arg(file);
            }
        }
        for setting in resources(&self.run.config, is_alone) {
            command.args(["--set", &setting]);
        }
        command.arg("--run").arg(self.folder.path());
        Running::start(&mut command, Output::at(self.folder.path().with_extension("txt")))
    }
}

/// Settings that share the machine out. They change no result.
fn resources(config: &RunConfig, is_alone: bool) -> [String; 4] {
    let frugal = ResourceConfig {
        actors: 1,
        learner_threads: 1,
        service_threads: 1,
        lease_timeout_ms: PATIENT_LEASE_TIMEOUT_MS,
    };
    let ResourceConfig { actors, learner_threads, service_threads, lease_timeout_ms } =
        if is_alone { &config.resources } else { &frugal };
    [
        format!("resources.actors={actors}"),
        format!("resources.learner_threads={learner_threads}"),
        format!("resources.service_threads={service_threads}"),
        format!("resources.lease_timeout_ms={lease_timeout_ms}"),
    ]
}

/// Demonstrations that are being recorded.
pub(super) struct Recorder {
    /// The process.
    pub(super) running: Running,
    file: PathBuf,
}

impl Recorder {
    /// Lets the expert begin.
    pub(super) fn start(config: &RunConfig, file: PathBuf) -> Result<Recorder> {
        let output = Output::at(file.with_extension("txt"));
        let mut actor = Recording::for_run(config, &file).actor()?;
        let running = Running::start(&mut actor, output)?;
        Ok(Recorder { running, file })
    }

    /// What it is doing, with how far it is as far as it has said so.
    pub(super) fn words(&self) -> String {
        let end = self.running.output.end().unwrap_or_default();
        match end.lines().rev().find_map(headway::read) {
            Some(headway) => format!("{RECORDING} {} %", headway::percent(headway)),
            None => RECORDING.to_owned(),
        }
    }

    /// Checks that the expert `ended` well: the demonstrations have their name then.
    ///
    /// # Errors
    /// When it did not, with its last words.
    pub(super) fn end(self, ended: ExitStatus) -> Result<()> {
        if ended.success() {
            return Ok(());
        }
        let (shown, words) = (self.file.display(), self.running.output().last_lines());
        bail!("recording {shown} failed ({ended}); {words}")
    }
}
