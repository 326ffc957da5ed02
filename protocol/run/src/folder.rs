//! The folder of a run: the paths of its files, and its newest checkpoint.

use std::path::{Path, PathBuf};

use mcap_log::log_files;
use protocol::{Error, durable};

use crate::config::{ActionChoice, RunConfig};
use crate::holder::{Holder, Work};

/// Name of the folder with the runs of an experiment.
pub const RUNS_FOLDER: &str = "runs";

/// The folder of a run. Everything in it except the log is derived from configuration, seed and log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RunFolder {
    path: PathBuf,
}

impl RunFolder {
    /// Returns the folder of the run at `path`, which need not exist yet.
    pub fn new(path: impl Into<PathBuf>) -> RunFolder {
        RunFolder { path: path.into() }
    }

    /// Returns the path of the folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the run at a path, or else the runs that are directly in the folder, in the order of their paths. Of an
    /// experiment's folder, those are in [`RUNS_FOLDER`], unless that is a link, which may lead anywhere.
    ///
    /// # Errors
    /// The operating system's error, when the folder cannot be read.
    pub fn all_at(path: &Path) -> std::io::Result<Vec<RunFolder>> {
        let named = RunFolder::new(path);
        if named.config_file().is_file() {
            return Ok(vec![named]);
        }
        let (found, inner) = (RunFolder::all_in(path)?, path.join(RUNS_FOLDER));
        let is_of_experiment = found.is_empty() && inner.is_dir() && !inner.is_symlink();
        if is_of_experiment { RunFolder::all_in(&inner) } else { Ok(found) }
    }

    fn all_in(folder: &Path) -> std::io::Result<Vec<RunFolder>> {
        let paths = folder.read_dir()?.map(|entry| entry.map(|entry| entry.path()));
        let mut paths = paths.collect::<std::io::Result<Vec<PathBuf>>>()?;
        paths.sort();
        let runs = paths.into_iter().map(RunFolder::new);
        Ok(runs.filter(|run| run.config_file().is_file()).collect())
    }

    /// Returns whether a `goalward train` holds the folder right now. Takes the lock for a moment.
    pub fn is_trained(&self) -> bool {
        self.holder().is_some_and(|holder| holder.work == Work::Training)
    }

    /// Returns the process that holds the lock of the folder right now. Takes the lock for a moment.
    pub fn holder(&self) -> Option<Holder> {
        durable::is_locked(&self.lock_file()).then(|| self.last_holder())
    }

    /// Returns the process that held the lock last.
    pub fn last_holder(&self) -> Holder {
        Holder::from_text(&std::fs::read_to_string(self.lock_file()).unwrap_or_default())
    }

    /// Returns the file whose lock a process holds that works on the run. The lock of a folder would not do: on
    /// NFS and Lustre it does not exclude other machines.
    pub fn lock_file(&self) -> PathBuf {
        self.path.join("lock")
    }

    /// Returns the file of the effective configuration.
    pub fn config_file(&self) -> PathBuf {
        self.path.join("config.toml")
    }

    /// Returns the file of the demonstrations that the expert recorded for this run.
    pub fn demonstrations_file(&self) -> PathBuf {
        self.path.join("demonstrations.mcap")
    }

    /// Returns the folder of the MCAP log.
    pub fn log(&self) -> PathBuf {
        self.path.join("log")
    }

    /// Returns the folder of the checkpoints. Each is a folder named by the number of iterations finished.
    pub fn checkpoints(&self) -> PathBuf {
        self.path.join("checkpoints")
    }

    /// Returns the file with the progress of offline training, which exists until there is a checkpoint.
    pub fn offline_file(&self) -> PathBuf {
        self.checkpoints().join("offline.safetensors")
    }

    /// Returns the folder of what the processes print.
    pub fn output(&self) -> PathBuf {
        self.path.join("output")
    }

    /// Returns the file with the newest progress message while the run is trained.
    pub fn progress_file(&self) -> PathBuf {
        self.output().join("progress.pb")
    }

    /// Returns the file that lists the other machines taking part while the run is trained.
    pub fn hosts_file(&self) -> PathBuf {
        self.output().join("hosts.json")
    }

    /// Returns the file that says how the run listened for other machines when it was last trained.
    /// It does not exist if the run did not listen.
    pub fn listening_file(&self) -> PathBuf {
        self.output().join("listening.json")
    }

    /// Returns the file with which other machines join the run.
    pub fn join_file(&self) -> PathBuf {
        self.path.join("join.toml")
    }

    /// Returns the file with the summary of the finished run.
    pub fn summary_file(&self) -> PathBuf {
        self.path.join("summary.json")
    }

    /// Returns the file that records an evaluation of a policy version over `episodes` episodes.
    /// Its name has the seed if that is not the run's.
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

    /// Returns the file with the number of actors wanted from now on, if it was changed during training.
    pub fn actors_file(&self) -> PathBuf {
        self.path.join("actors")
    }

    /// Returns the file with the number of actors wanted on another machine that takes part.
    pub fn actors_file_of(&self, host: &str) -> PathBuf {
        self.output().join(format!("actors@{host}"))
    }

    /// Returns where the folder is now.
    ///
    /// # Errors
    /// [`Error::RunMoved`] if it does not exist.
    pub fn place(&self) -> Result<Place, Error> {
        let missing = |_| Error::RunMoved { path: self.path.clone() };
        let path = self.path.canonicalize().map_err(missing)?;
        let identity = identity(&path).map_err(missing)?;
        Ok(Place { path, identity })
    }

    /// Returns whether this is the folder of a run, even of a damaged one.
    pub fn is_run(&self) -> bool {
        self.config().is_ok() || log_files(&self.log()).is_ok_and(|files| !files.is_empty())
    }

    /// Reads the effective configuration.
    ///
    /// # Errors
    /// [`Error::NotARun`] if there is no configuration; as [`RunConfig::from_text`] if it is invalid.
    pub fn config(&self) -> Result<RunConfig, Error> {
        let file = self.config_file();
        let text = std::fs::read_to_string(&file).map_err(|error| Error::NotARun {
            path: self.path.clone(),
            message: format!("expected {}: {error}", file.display()),
        })?;
        RunConfig::from_text(&text, &file.display().to_string())
    }

    /// Returns all checkpoints, oldest first, as (iterations finished, folder).
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

    /// Returns the newest checkpoint without checking it; [`crate::checkpoint::newest`] checks.
    pub fn newest_checkpoint(&self) -> Option<(u64, PathBuf)> {
        self.checkpoint_folders().pop()
    }

    /// Returns the folder of the checkpoint after `iteration` iterations.
    pub fn checkpoint_folder(&self, iteration: u64) -> PathBuf {
        self.checkpoints().join(format!("{iteration:06}"))
    }
}

/// Where a run's folder was found. Its processes use it to notice that the folder was moved or removed:
/// files that they have open would still accept data, and a new folder under the old name is not the run's.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Place {
    path: PathBuf,
    /// Device and inode number of the folder.
    identity: (u64, u64),
}

impl Place {
    /// Checks that the folder is still there.
    ///
    /// # Errors
    /// [`Error::RunMoved`] if it is not, or if another folder has taken its place.
    pub fn check(&self) -> Result<(), Error> {
        match identity(&self.path) {
            Ok(identity) if identity == self.identity => Ok(()),
            _ => Err(Error::RunMoved { path: self.path.clone() }),
        }
    }
}

fn identity(folder: &Path) -> std::io::Result<(u64, u64)> {
    std::fs::metadata(folder).map(|found| durable::identity(&found))
}

/// Name of the file with the policy's weights in a checkpoint folder. Acting needs no other file.
pub const POLICY_FILE: &str = "policy.safetensors";

/// Name of the file with the learner's own state in a checkpoint folder.
pub const LEARNER_FILE: &str = "learner.safetensors";

/// Name of the file with the proximity service's state in a checkpoint folder.
pub const PROXIMITY_FILE: &str = "proximity.safetensors";

/// Names of all files in a checkpoint folder.
pub const CHECKPOINT_FILES: [&str; 3] = [POLICY_FILE, LEARNER_FILE, PROXIMITY_FILE];

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn a_run_stands_for_itself_and_a_folder_for_the_runs_in_it() {
        let directory = tempfile::tempdir().unwrap();
        let made = |name: &str| {
            let run = RunFolder::new(directory.path().join(name));
            fs::create_dir_all(run.path()).unwrap();
            fs::write(run.config_file(), "").unwrap();
            run
        };
        let runs = ["experiment/runs/a", "experiment/runs/b"].map(made);
        let at = |name: &str| RunFolder::all_at(&directory.path().join(name));
        for (name, expected) in [
            ("experiment/runs/a", &runs[..1]),
            ("experiment/runs", &runs[..]),
            ("experiment", &runs[..]),
            (".", &runs[2..]),
        ] {
            assert_eq!(at(name).unwrap(), expected, "{name}");
        }
        assert!(at("nowhere").is_err());
    }

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
