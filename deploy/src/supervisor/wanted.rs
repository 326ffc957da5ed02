//! How many actors a run is to have, which can change while it trains.
//!
//! The number wanted is a file in the run's folder: `goalward scale` writes it, the supervisor looks
//! at it. Whether it is seen sooner or later, and who runs which lease, changes no result.

use std::fs;
use std::path::PathBuf;

use anyhow::{Context, Result};
use protocol::bus::MAX_ACTORS;
use protocol::run::RunFolder;

/// Tells the supervisor of a run how many actors are wanted from now on.
pub(crate) fn want_actors(folder: &RunFolder, count: u64) -> Result<()> {
    let file = folder.actors_file();
    let unfinished = file.with_extension("new");
    fs::write(&unfinished, count.to_string())
        .and_then(|()| fs::rename(&unfinished, &file))
        .with_context(|| file.display().to_string())
}

/// The supervisor's view of the number wanted.
pub(super) struct ActorsWanted {
    file: PathBuf,
    known: Option<String>,
}

impl ActorsWanted {
    /// Nobody has wanted anything yet; wishes of an earlier start are forgotten.
    ///
    /// # Errors
    /// When they cannot be removed.
    pub(super) fn fresh(folder: &RunFolder) -> Result<ActorsWanted> {
        let file = folder.actors_file();
        match fs::remove_file(&file) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                Err(error).with_context(|| file.display().to_string())
            }
            _ => Ok(ActorsWanted { file, known: None }),
        }
    }

    /// The number wanted, if it has changed since the last look.
    ///
    /// # Errors
    /// When there is something else in the file.
    pub(super) fn changed(&mut self) -> Result<Option<u64>> {
        let Ok(text) = fs::read_to_string(&self.file) else { return Ok(None) };
        if self.known.as_ref() == Some(&text) {
            return Ok(None);
        }
        let allowed = 1..=MAX_ACTORS as u64;
        let count = text.parse().ok().filter(|count| allowed.contains(count));
        let count = count.with_context(|| {
            format!("{}: expected 1 to {MAX_ACTORS} actors, found {text:?}", self.file.display())
        })?;
        self.known = Some(text);
        Ok(Some(count))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wish_is_seen_once_and_not_from_an_earlier_start() {
        let directory = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(directory.path());
        fs::write(folder.actors_file(), "7").unwrap();
        let mut wanted = ActorsWanted::fresh(&folder).unwrap();
        assert_eq!(wanted.changed().unwrap(), None);
        want_actors(&folder, 3).unwrap();
        assert_eq!(wanted.changed().unwrap(), Some(3));
        assert_eq!(wanted.changed().unwrap(), None);
        fs::write(folder.actors_file(), "many").unwrap();
        assert!(wanted.changed().unwrap_err().to_string().contains("found \"many\""));
    }
}
