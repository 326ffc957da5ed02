//! The collections of episodes of a run: its log, its demonstrations and its evaluations.

use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::SystemTime;

use run::config::RunConfig;
use run::demonstrations;
use run::folder::RunFolder;

use crate::episodes::Episodes;

/// The collection of a run's training episodes and of its evaluation at the end.
const LOG: &str = "log";

/// The collection of the demonstrations that a run learns from.
const DEMONSTRATIONS: &str = "demonstrations";

/// Maximum number of collections whose rows are cached.
const KEPT: usize = 8;

/// A run's folder, when the run began, and the name of a collection.
type Key = (PathBuf, u64, String);

/// A cache of collections.
#[derive(Default)]
pub(crate) struct Collections {
    kept: Mutex<BTreeMap<Key, Arc<Mutex<Episodes>>>>,
}

/// Returns when a run's configuration was written, in milliseconds since 1970; 0 if that is not known. It tells a run
/// from another one that took its folder's name.
pub(crate) fn begun_ms(folder: &RunFolder) -> u64 {
    let written = fs::metadata(folder.config_file()).and_then(|file| file.modified());
    let since = written.ok().and_then(|time| time.duration_since(SystemTime::UNIX_EPOCH).ok());
    since.map_or(0, |since| since.as_millis() as u64)
}

/// Returns the names of a run's collections.
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
    /// Returns the episodes of a collection, up to date; `None` if the run has no such collection.
    pub(crate) fn get(
        &self,
        folder: &RunFolder,
        config: &RunConfig,
        name: &str,
    ) -> Option<Arc<Mutex<Episodes>>> {
        if !names(folder, config).iter().any(|other| other == name) {
            return None;
        }
        let begun_ms = begun_ms(folder);
        let key = (folder.path().to_owned(), begun_ms, name.to_owned());
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        if kept.len() >= KEPT && !kept.contains_key(&key) {
            kept.clear();
        }
        let new = || Arc::new(Mutex::new(Episodes::of_generation(begun_ms)));
        let episodes = Arc::clone(kept.entry(key).or_insert_with(new));
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

/// Locks a collection. A poisoned lock is taken too: a thread that panicked has left whole rows.
pub(crate) fn locked(episodes: &Mutex<Episodes>) -> MutexGuard<'_, Episodes> {
    episodes.lock().unwrap_or_else(PoisonError::into_inner)
}
