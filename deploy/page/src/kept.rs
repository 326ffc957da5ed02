//! A cache of what was read from runs, valid until their files change.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::SystemTime;

use mcap_log::{Contents, log_files};
use run::folder::RunFolder;

/// A value for each run.
#[derive(Debug)]
pub(crate) struct Kept<T> {
    most: usize,
    of_runs: Mutex<BTreeMap<PathBuf, (Stamp, T)>>,
}

impl<T: Clone> Kept<T> {
    /// Returns an empty cache for `most` runs; one more run clears it.
    pub(crate) fn of(most: usize) -> Kept<T> {
        Kept { most, of_runs: Mutex::default() }
    }

    /// Returns the cached value of the run at `path`, or calls `read` if its files have changed since.
    pub(crate) fn get(&self, path: &Path, read: impl FnOnce(&RunFolder) -> T) -> T {
        let folder = RunFolder::new(path);
        let stamp = Stamp::of(&folder);
        let runs = || self.of_runs.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, kept)) = runs().get(path).filter(|(known, _)| *known == stamp) {
            return kept.clone();
        }
        // Others can look up their runs in the meantime.
        let new = read(&folder);
        let mut runs = runs();
        if runs.len() >= self.most && !runs.contains_key(path) {
            runs.clear();
        }
        runs.insert(path.to_owned(), (stamp, new.clone()));
        new
    }
}

/// Identifies a state of a run: whether it is being trained, and the times and sizes of its configuration, its summary
/// and the newest log file of updates.
#[derive(Debug, PartialEq, Eq)]
struct Stamp {
    is_trained: bool,
    files: [Option<(SystemTime, u64)>; 3],
}

impl Stamp {
    fn of(folder: &RunFolder) -> Stamp {
        let files = log_files(&folder.log()).into_iter().flatten();
        let newest = files.rev().find(|file| file.contents == Contents::Updates);
        let newest = newest.and_then(|file| state(&file.path));
        let files = [state(&folder.config_file()), state(&folder.summary_file()), newest];
        Stamp { is_trained: folder.is_trained(), files }
    }
}

fn state(path: &Path) -> Option<(SystemTime, u64)> {
    let metadata = fs::metadata(path).ok()?;
    Some((metadata.modified().ok()?, metadata.len()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_is_read_again_once_its_files_have_changed() {
        let directory = tempfile::tempdir().unwrap();
        let kept = Kept::of(1);
        let number = |number: u32| kept.get(directory.path(), |_| number);
        fs::write(directory.path().join("config.toml"), "a").unwrap();
        assert_eq!([number(1), number(2)], [1, 1]);
        fs::write(directory.path().join("config.toml"), "ab").unwrap();
        assert_eq!([number(3), number(4)], [3, 3]);
        let lock = fs::File::create(RunFolder::new(directory.path()).lock_file()).unwrap();
        lock.lock().unwrap();
        assert_eq!(number(5), 5, "it is trained now");
        assert_eq!(kept.get(Path::new("elsewhere"), |_| 6), 6);
        assert_eq!(number(7), 7, "another took its place");
    }
}
