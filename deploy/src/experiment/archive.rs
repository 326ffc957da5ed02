//! An experiment's folder: where runs, what they print and demonstrations lie in it.
//!
//! A run's folder is called `TASK-METHOD-sSEED-HASH`. The hash stands for all that decides the
//! result, and for nothing else: not for the names of method and preset, whose values are in it. So
//! a run that two figures show, or an ablation that is the default, lies in one folder, under the
//! method's name that came first. The build of a program that the user's own task brings along is in it, too.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use protocol::table::CHANGES_NO_RESULT;
use run::config::RunConfig;
use run::demonstrations::SHARED_FOLDER;
use run::folder::RunFolder;
use serde_json::Value;
use xxhash_rust::xxh3::xxh3_64;

use super::planned_run::PlannedRun;

/// Names of what other parts of a configuration spell out.
const NAMES: [&str; 2] = ["method", "preset"];

/// An experiment's folder.
#[derive(Debug)]
pub(crate) struct Archive {
    path: PathBuf,
    /// Names of runs, those to come included, by hash.
    names: BTreeMap<String, String>,
}

impl Archive {
    /// The experiment in the folder `path`, which need not exist yet.
    pub(crate) fn open(path: &Path) -> Archive {
        let mut archive = Archive { path: path.to_owned(), names: BTreeMap::new() };
        let entries = fs::read_dir(archive.runs()).into_iter().flatten().flatten();
        let mut names: Vec<_> =
            entries.filter_map(|entry| entry.file_name().into_string().ok()).collect();
        names.sort();
        for name in names {
            if let Some((_, hash)) = name.rsplit_once('-').filter(|(_, hash)| !hash.contains('.')) {
                archive.names.insert(hash.to_owned(), name);
            }
        }
        archive
    }

    /// Folder of the runs, and of what `goalward train` printed for each.
    pub(crate) fn runs(&self) -> PathBuf {
        self.path.join("runs")
    }

    /// Folder of the demonstrations.
    pub(crate) fn demonstrations(&self) -> PathBuf {
        self.path.join(SHARED_FOLDER)
    }

    /// The name of a run, whether it is there or to come.
    pub(crate) fn name_of(&mut self, run: &PlannedRun) -> String {
        let RunConfig { task, method, seed, .. } = &run.config;
        let hash = identity(&run.config);
        let name = self
            .names
            .entry(hash)
            .or_insert_with_key(|hash| format!("{task}-{method}-s{seed}-{hash}"));
        name.clone()
    }

    /// The folder of a run, whether it is there or to come.
    pub(crate) fn folder_of(&mut self, run: &PlannedRun) -> RunFolder {
        RunFolder::new(self.runs().join(self.name_of(run)))
    }

    /// The demonstrations a run learns from: one file for all runs that need the same.
    pub(crate) fn demonstrations_of(&self, config: &RunConfig) -> PathBuf {
        let setting = serde_json::to_string(&config.demonstration_setting())
            .expect("a setting has only numbers and texts");
        let RunConfig { task, seed, demonstrations, .. } = config;
        // Nothing for a task of ours.
        let program = task.program_sha256.as_deref().unwrap_or_default();
        let (episodes, hash) = (demonstrations.episodes, short_hash(&(setting + program)));
        self.demonstrations().join(format!("{task}-{episodes}-s{seed}-{hash}.mcap"))
    }
}

/// What two runs have in common that give the same result.
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
