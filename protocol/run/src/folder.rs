//! The folder of a run: what lies where, and which checkpoint is the newest.

use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use mcap_log::log_files;
use protocol::{Error, durable};

use crate::config::{ActionChoice, RunConfig};

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

    /// Whether a `goalward train` has the folder right now. Asking takes its lock for a moment.
    pub fn is_trained(&self) -> bool {
        durable::is_locked(&self.lock_file())
    }

    /// The file whose lock a `goalward train` holds: on NFS and Lustre the lock of a folder keeps nobody out on
    /// another machine.
    pub fn lock_file(&self) -> PathBuf {
        self.path.join("lock")
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

    /// How far offline training has come, until there is a checkpoint.
    pub fn offline_file(&self) -> PathBuf {
        self.checkpoints().join("offline.safetensors")
    }

    /// Folder of what the processes printed.
    pub fn output(&self) -> PathBuf {
        self.path.join("output")
    }

    /// The newest message of progress while the run is trained.
    pub fn progress_file(&self) -> PathBuf {
        self.output().join("progress.pb")
    }

    /// The other machines that take part while the run is trained.
    pub fn hosts_file(&self) -> PathBuf {
        self.output().join("hosts.json")
    }

    /// How the run listened for them when it was trained last; none where it did not.
    pub fn listening_file(&self) -> PathBuf {
        self.output().join("listening.json")
    }

    /// Summary of the finished run.
    pub fn summary_file(&self) -> PathBuf {
        self.path.join("summary.json")
    }

    /// What an evaluation of a version of the policy in so many episodes is recorded in; it names a seed that
    /// is not the run's.
    pub fn evaluation_file(
        &self,
        policy_version: u64,
        episodes: u64,
        actions: ActionChoice,
        other_seed: Option<u64>,
    ) -> PathBuf {
        let actions = actions.name();
        let seed = other_seed.map(|seed| format!("-seed{seed}")).unwrap_or_default();
        self.path.join(format!("evaluation-v{policy_version:06}-{episodes}-{actions}{seed}.mcap"))
    }

    /// How many actors the run is to have from now on, if that was changed while it trained.
    pub fn actors_file(&self) -> PathBuf {
        self.path.join("actors")
    }

    /// The same of another machine that takes part.
    pub fn actors_file_of(&self, host: &str) -> PathBuf {
        self.output().join(format!("actors@{host}"))
    }

    /// Where the folder is now.
    ///
    /// # Errors
    /// When it is not there.
    pub fn place(&self) -> Result<Place, Error> {
        let missing = |_| Error::RunMoved { path: self.path.clone() };
        let path = self.path.canonicalize().map_err(missing)?;
        let identity = identity(&path).map_err(missing)?;
        Ok(Place { path, identity })
    }

    /// Whether this is the folder of a run, though perhaps of a damaged one.
    pub fn is_run(&self) -> bool {
        self.config().is_ok() || log_files(&self.log()).is_ok_and(|files| !files.is_empty())
    }

    /// Reads the effective configuration.
    ///
    /// # Errors
    /// [`Error::NotARun`] without a configuration; as [`RunConfig::from_text`] for one that is not sound.
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

    /// The newest checkpoint there is, sound or not; [`crate::checkpoint::newest`] looks into them.
    pub fn newest_checkpoint(&self) -> Option<(u64, PathBuf)> {
        self.checkpoint_folders().pop()
    }

    /// Folder of the checkpoint after `iteration` iterations.
    pub fn checkpoint_folder(&self, iteration: u64) -> PathBuf {
        self.checkpoints().join(format!("{iteration:06}"))
    }
}

/// Where a run's folder was found, so that its processes notice when it is moved or removed: what they
/// have open would still take what they write, and a folder made anew under the old name is not the run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Place {
    path: PathBuf,
    /// Device and number of the folder on it.
    identity: (u64, u64),
}

impl Place {
    /// Checks that the folder is still there.
    ///
    /// # Errors
    /// [`Error::RunMoved`] when it is not, or another one is.
    pub fn check(&self) -> Result<(), Error> {
        match identity(&self.path) {
            Ok(identity) if identity == self.identity => Ok(()),
            _ => Err(Error::RunMoved { path: self.path.clone() }),
        }
    }
}

fn identity(folder: &Path) -> std::io::Result<(u64, u64)> {
    std::fs::metadata(folder).map(|found| (found.dev(), found.ino()))
}

/// The policy's weights within a checkpoint folder, all that acting needs.
pub const POLICY_FILE: &str = "policy.safetensors";

/// The learner's own state within a checkpoint folder.
pub const LEARNER_FILE: &str = "learner.safetensors";

/// The proximity service's state within a checkpoint folder.
pub const PROXIMITY_FILE: &str = "proximity.safetensors";

/// All files of a checkpoint folder.
pub const CHECKPOINT_FILES: [&str; 3] = [POLICY_FILE, LEARNER_FILE, PROXIMITY_FILE];

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn a_folder_that_was_moved_removed_or_replaced_is_noticed() {
        let directory = tempfile::tempdir().unwrap();
        let (here, there) = (directory.path().join("here"), directory.path().join("there"));
        fs::create_dir(&here).unwrap();
        let place = RunFolder::new(&here).place().unwrap();
        place.check().unwrap();
        fs::rename(&here, &there).unwrap();
        assert!(place.check().unwrap_err().to_string().contains("moved or removed"));
        fs::create_dir(&here).unwrap();
        assert!(place.check().is_err(), "another folder of the name");
        fs::remove_dir(&here).unwrap();
        fs::rename(&there, &here).unwrap();
        place.check().unwrap();
    }
}
