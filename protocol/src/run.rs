//! The folder of a run: what lies where, and which checkpoint is the newest whole one.

use std::path::{Path, PathBuf};

use crate::Error;
use crate::config::RunConfig;

/// The folder of a run. Everything in it but the log is derived from configuration, seed and log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RunFolder {
    path: PathBuf,
}

impl RunFolder {
    /// The run at `path`, which need not exist yet.
    pub fn new(path: impl Into<PathBuf>) -> RunFolder {
        RunFolder { path: path.into() }
    }

    /// The folder itself.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The effective configuration.
    pub fn config_file(&self) -> PathBuf {
        self.path.join("config.toml")
    }

    /// The demonstrations the expert recorded for this run.
    pub fn demonstrations_file(&self) -> PathBuf {
        self.path.join("demonstrations.mcap")
    }

    /// Folder of the MCAP log.
    pub fn log(&self) -> PathBuf {
        self.path.join("log")
    }

    /// Folder of the checkpoints, one folder each, named by the iterations finished.
    pub fn checkpoints(&self) -> PathBuf {
        self.path.join("checkpoints")
    }

    /// Folder of what the processes printed.
    pub fn output(&self) -> PathBuf {
        self.path.join("output")
    }

    /// Figures of the finished run.
    pub fn summary_file(&self) -> PathBuf {
        self.path.join("summary.json")
    }

    /// How many actors the run is to have from now on, if that was changed while it trained.
    pub fn actors_file(&self) -> PathBuf {
        self.path.join("actors")
    }

    /// Reads the effective configuration.
    pub fn config(&self) -> Result<RunConfig, Error> {
        let file = self.config_file();
        let text = std::fs::read_to_string(&file).map_err(|error| Error::NotARun {
            path: self.path.clone(),
            message: format!("expected {}: {error}", file.display()),
        })?;
        RunConfig::from_text(&text, &file.display().to_string())
    }

    /// The checkpoints there are, oldest first, as (iterations finished, folder).
    pub fn checkpoint_folders(&self) -> Vec<(u64, PathBuf)> {
        let Ok(entries) = std::fs::read_dir(self.checkpoints()) else { return Vec::new() };
        let number = |path: &Path| path.file_name()?.to_str()?.parse::<u64>().ok();
        let mut folders: Vec<_> = entries
            .filter_map(|entry| entry.ok().map(|entry| entry.path()))
            .filter_map(|path| number(&path).map(|iteration| (iteration, path)))
            .collect();
        folders.sort();
        folders
    }

    /// The newest checkpoint.
    pub fn newest_checkpoint(&self) -> Option<(u64, PathBuf)> {
        self.checkpoint_folders().pop()
    }

    /// Folder of the checkpoint after `iteration` iterations.
    pub fn checkpoint_folder(&self, iteration: u64) -> PathBuf {
        self.checkpoints().join(format!("{iteration:06}"))
    }
}

/// The policy's weights within a checkpoint folder, all that acting needs.
pub const POLICY_FILE: &str = "policy.safetensors";

/// The learner's own state within a checkpoint folder.
pub const LEARNER_FILE: &str = "learner.safetensors";

/// The proximity service's state within a checkpoint folder.
pub const PROXIMITY_FILE: &str = "proximity.safetensors";
