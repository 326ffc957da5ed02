//! An experiment's folder: where its runs, their output and their demonstrations are.
//!
//! A run's folder is called `TASK-METHOD-sSEED-HASH`. The hash stands for everything that decides the result and for
//! nothing else. It leaves out the names of method and preset, since their values are in it; it includes the build of a
//! program that the user's own task brings. A run that two figures show, or an ablation that equals the default, is
//! thus in one folder, named after the method that came first.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use protocol::table::CHANGES_NO_RESULT;
use run::config::RunConfig;
use run::demonstrations::SHARED_FOLDER;
use run::folder::{RUNS_FOLDER, RunFolder};
use serde_json::Value;
use xxhash_rust::xxh3::xxh3_64;

use super::planned_run::PlannedRun;

/// Keys whose values only name what other keys spell out.
const NAMES: [&str; 2] = ["method", "preset"];

/// An experiment's folder.
#[derive(Debug)]
pub(crate) struct Archive {
    path: PathBuf,
    /// Names of runs, including future ones, by hash.
    names: BTreeMap<String, String>,
}

impl Archive {
    /// Opens the experiment in the folder `path`, which need not exist yet.
    pub(crate) fn open(path: &Path) -> Archive {
        let mut archive = Archive { path: path.to_owned(), names: BTreeMap::new() };
        archive.look();
        archive
    }

    /// Takes the names of the runs that exist now.
    pub(super) fn look(&mut self) {
        self.names = names_in(&self.runs());
    }

    /// Returns the folder of the runs, and of what `goalward train` printed for each.
    pub(crate) fn runs(&self) -> PathBuf {
        self.path.join(RUNS_FOLDER)
    }

    /// Returns the folder of the demonstrations.
    pub(crate) fn demonstrations(&self) -> PathBuf {
        self.path.join(SHARED_FOLDER)
    }

    /// Returns the name of a run, which need not exist yet.
    pub(crate) fn name_of(&mut self, run: &PlannedRun) -> String {
        let RunConfig { task, method, seed, .. } = &run.config;
        let hash = identity(&run.config);
        let name = self
            .names
            .entry(hash)
            .or_insert_with_key(|hash| format!("{task}-{method}-s{seed}-{hash}"));
        name.clone()
    }

    /// Returns the folder of a run, which need not exist yet.
    pub(crate) fn folder_of(&mut self, run: &PlannedRun) -> RunFolder {
        RunFolder::new(self.runs().join(self.name_of(run)))
    }

    /// Returns the file of demonstrations that a run learns from: one file for all runs that need the same.
    pub(crate) fn demonstrations_of(&self, config: &RunConfig) -> PathBuf {
        let setting = serde_json::to_string(&config.demonstration_setting())
            .expect("a setting has only numbers and texts");
        let RunConfig { task, seed, demonstrations, .. } = config;
        // Empty for the built-in tasks.
        let program = task.program_sha256.as_deref().unwrap_or_default();
        let (episodes, hash) = (demonstrations.episodes, short_hash(&(setting + program)));
        self.demonstrations().join(format!("{task}-{episodes}-s{seed}-{hash}.mcap"))
    }
}

/// Returns the name of the run in the folder `runs` that gives the same result as the run called `name`; `None` if
/// there is no such run.
pub(super) fn twin_of(name: &str, runs: &Path) -> Option<String> {
    names_in(runs).remove(hash_of(name)?)
}

/// Returns the names of the runs in a folder by hash. If two have the same, because two experiments began them at the
/// same moment, the finished one counts.
fn names_in(runs: &Path) -> BTreeMap<String, String> {
    let entries = fs::read_dir(runs).into_iter().flatten().flatten();
    let names = entries.filter_map(|entry| entry.file_name().into_string().ok());
    let is_finished = |name: &String| RunFolder::new(runs.join(name)).summary_file().exists();
    let mut known: Vec<_> = names.filter(|name| hash_of(name).is_some()).collect();
    known.sort_by_key(|name| (is_finished(name), name.clone()));
    let by_hash = |name: String| Some((hash_of(&name)?.to_owned(), name));
    known.into_iter().filter_map(by_hash).collect()
}

/// Returns the hash in the name of a run; `None` if it is the name of something else.
fn hash_of(name: &str) -> Option<&str> {
    name.rsplit_once('-').map(|(_, hash)| hash).filter(|hash| !hash.contains('.'))
}

/// Returns the hash that runs share if they give the same result.
fn identity(config: &RunConfig) -> String {
    let mut values = serde_json::to_value(config).expect("a configuration has only plain values");
    if let Value::Object(values) = &mut values {
        let decides = |key: &str| !CHANGES_NO_RESULT.contains(&key) && !NAMES.contains(&key);
        values.retain(|key, _| decides(key));
    }
    // Keys are in alphabetical order.
    short_hash(&values.to_string())
}

fn short_hash(text: &str) -> String {
    format!("{:08x}", xxh3_64(text.as_bytes()) >> 32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_runs_with_the_same_result_the_finished_one_counts() {
        let directory = tempfile::tempdir().unwrap();
        let runs = directory.path();
        assert_eq!(twin_of("navigation-difference-s1-12345678", runs), None);
        for name in ["navigation-a-s1-12345678", "navigation-b-s1-12345678"] {
            fs::create_dir(runs.join(name)).unwrap();
        }
        fs::write(runs.join("navigation-c-s1-12345678.txt"), "").unwrap();
        fs::write(runs.join("navigation-a-s1-12345678/summary.json"), "").unwrap();
        let twin = twin_of("navigation-difference-s1-12345678", runs);
        assert_eq!(twin.as_deref(), Some("navigation-a-s1-12345678"));
        assert_eq!(twin_of("navigation-difference-s2-12345679", runs), None);
    }
}
