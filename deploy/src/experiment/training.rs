//! A run of an experiment: a `goalward train` of its own.

use std::path::PathBuf;
use std::process::{Command, Stdio};

use anyhow::{Context, Result, ensure};
use protocol::durable;
use run::config::{ResourceConfig, RunConfig};
use run::folder::RunFolder;
use run::summary::Summary;
use terminal::numbers;

use super::archive::{self, Archive};
use super::planned_run::PlannedRun;
use crate::child::Child;
use crate::output::Output;
use crate::{description, progress_file};

/// Lease timeout, milliseconds: so long that no lease is handed out again because other runs keep an actor waiting.
const PATIENT_LEASE_TIMEOUT_MS: u64 = 120_000;

/// What is to be trained, and where.
pub(super) struct Training {
    /// The run.
    pub(super) run: PlannedRun,
    /// Name of the run and of its folder.
    pub(super) name: String,
    /// Folder of the run.
    pub(super) folder: RunFolder,
    /// File of demonstrations that the experiment provides.
    pub(super) demonstrations: Option<PathBuf>,
}

impl Training {
    /// Creates the training of a planned run.
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

    /// Makes the folder of the run or, if another experiment has begun the same run under the name of another method
    /// since, takes that one's.
    ///
    /// # Errors
    /// When the folder cannot be made.
    pub(super) fn claim(&mut self) -> std::io::Result<()> {
        let runs = durable::folder_of(self.folder.path()).to_owned();
        if let Some(twin) = archive::twin_of(&self.name, &runs) {
            self.folder = RunFolder::new(runs.join(&twin));
            self.name = twin;
        }
        durable::create_folder(self.folder.path())
    }

    /// Returns whether another `goalward train` is training the run.
    pub(super) fn is_elsewhere(&self) -> bool {
        self.folder.is_trained()
    }

    /// Checks that the task's own program is the one that gave the run its name.
    ///
    /// # Errors
    /// When the program was rebuilt since the plan was read, or cannot be read.
    pub(super) fn require_same_program(&self) -> Result<()> {
        let task = &self.run.config.task;
        let Some(program) = &task.program else { return Ok(()) };
        ensure!(
            description::program_sha256(task)? == task.program_sha256,
            "{}: expected the program that the experiment began with, found a rebuilt one: start the \
             experiment again",
            program.display()
        );
        Ok(())
    }

    /// Returns the file of demonstrations that is to be recorded before the run starts.
    pub(super) fn missing_demonstrations(&self) -> Option<PathBuf> {
        self.demonstrations.clone().filter(|file| !file.exists())
    }

    /// Returns the run's summary if the run is finished.
    pub(super) fn summary(&self) -> Option<Summary> {
        Summary::of_run(&self.folder).unwrap_or(None)
    }

    /// Returns the output of the run's `goalward train`.
    pub(super) fn output(&self) -> Output {
        let mut path = self.folder.path().as_os_str().to_owned();
        path.push(".txt");
        Output::at(path.into())
    }

    /// Returns how far the run is, as far as it has said so.
    pub(super) fn standing(&self) -> Option<Standing> {
        let progress = progress_file::read(&self.folder)?;
        if progress.steps_wanted == 0 {
            return None;
        }
        let percent = numbers::percent_done(progress.environment_steps(), progress.steps_wanted);
        let success_rate = progress.update.map_or(f64::NAN, |update| update.success_rate);
        Some(Standing { percent, success_rate })
    }

    /// Starts `goalward train`, or continues a run that has begun. Where other runs train beside it, each gets one
    /// actor, and one thread per process.
    pub(super) fn start(&self, is_alone: bool, other_build: bool) -> Result<Child> {
        let goalward = std::env::current_exe().context("finding goalward itself")?;
        let mut command = Command::new(goalward);
        command.args(["train", "--no-page"]).stdin(Stdio::null());
        if self.folder.config_file().exists() {
            command.arg("--resume").args(other_build.then_some("--other-build"));
        } else {
            command.arg(&self.run.task).args(["--preset", &self.run.config.preset]);
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
        Child::start(&mut command, &self.output())
    }
}

/// How far a run is.
#[derive(Clone, Copy, Debug)]
pub(super) struct Standing {
    /// Percentage of the run's steps that were learned from.
    pub(super) percent: u64,
    /// Success rate of the last 100 training episodes; NaN if there is none.
    pub(super) success_rate: f64,
}

impl Standing {
    /// Returns the fraction of the steps that is left.
    pub(super) fn part_left(self) -> f64 {
        1.0 - self.percent as f64 / 100.0
    }
}

/// Returns settings that divide the machine between runs. They change no result.
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
