//! The collections of episodes that a run has: its log, its demonstrations, evaluations of it.

use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::SystemTime;

use run::config::RunConfig;
use run::demonstrations;
use run::folder::RunFolder;

use crate::episodes::Episodes;

/// The collection of what a run was trained with and evaluated in at its end.
const LOG: &str = "log";

/// The collection of what a run learns from.
const DEMONSTRATIONS: &str = "demonstrations";

/// Collections of which the rows are kept.
const KEPT: usize = 8;

/// A run's folder as it was laid out, and one of its collections.
type Key = (PathBuf, Option<SystemTime>, String);

/// What has been read of collections.
#[derive(Default)]
pub(crate) struct Collections {
    kept: Mutex<BTreeMap<Key, Arc<Mutex<Episodes>>>>,
}

/// The names of a run's collections.
pub(crate) fn names(folder: &RunFolder, config: &RunConfig) -> Vec<String> {
    let mut names = vec![LOG.to_owned()];
    if demonstrations::file_of(folder, config).is_file() {
        names.push(DEMONSTRATIONS.to_owned());
    }
    let mut evaluations: Vec<String> = fs::read_dir(folder.path())
        .into_iter()
        .flatten()
        .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
        .filter(|name| name.starts_with("evaluation-") && name.ends_with(".mcap"))
        .collect();
    evaluations.sort();
    names.extend(evaluations);
    names
}

impl Collections {
    /// The episodes of a collection as they are now; none where a run has no such collection.
    pub(crate) fn get(
        &self,
        folder: &RunFolder,
        config: &RunConfig,
        name: &str,
    ) -> Option<Arc<Mutex<Episodes>>> {
        if !names(folder, config).iter().any(|other| other == name) {
            return None;
        }
        let laid_out = fs::metadata(folder.config_file()).and_then(|file| file.modified()).ok();
        let key = (folder.path().to_owned(), laid_out, name.to_owned());
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        if kept.len() >= KEPT && !kept.contains_key(&key) {
            kept.clear();
        }
        let episodes = Arc::clone(kept.entry(key).or_default());
        drop(kept);
        let mut reading = locked(&episodes);
        match name {
            LOG => reading.read_log(&folder.log()),
            DEMONSTRATIONS => reading.read_file(demonstrations::file_of(folder, config)),
            file => reading.read_file(folder.path().join(file)),
        }
        drop(reading);
        Some(episodes)
    }
}

/// What is read of a collection. A reader that has panicked left rows that are whole.
pub(crate) fn locked(episodes: &Mutex<Episodes>) -> MutexGuard<'_, Episodes> {
    episodes.lock().unwrap_or_else(PoisonError::into_inner)
}
