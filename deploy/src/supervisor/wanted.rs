//! How many actors a run is to have, which can change while it trains.
//!
//! The number wanted is a file in the run's folder: `goalward scale` writes it, the supervisor looks
//! at it; a run that is continued has it in its configuration. Whether it is seen sooner or later, and who runs which lease, changes no result.

use std::fs::{self, File};
use std::io::Read;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use bus::MAX_ACTORS;
use protocol::durable;
use run::folder::RunFolder;

/// Most bytes looked at.
const MOST_BYTES: u64 = 32;

/// Tells the supervisor of a run how many actors are wanted from now on.
pub(crate) fn want_actors(folder: &RunFolder, count: u64) -> Result<()> {
    let file = folder.actors_file();
    durable::write(&file, count.to_string()).with_context(|| file.display().to_string())
}

/// The number wanted, if `goalward scale` was called since the run was last laid out.
///
/// # Errors
/// When there is something else in the file.
pub(crate) fn actors_wanted(folder: &RunFolder) -> Result<Option<u64>> {
    let file = folder.actors_file();
    beginning(&file).map(|text| parsed(&text, &file)).transpose()
}

/// As much of the file as a number could have; none if there is no file.
fn beginning(file: &Path) -> Option<String> {
    let mut bytes = Vec::new();
    File::open(file).ok()?.take(MOST_BYTES).read_to_end(&mut bytes).ok()?;
    Some(String::from_utf8_lossy(&bytes).into_owned())
}

/// Forgets the number wanted: the run's configuration has it.
///
/// # Errors
/// When the file cannot be removed.
pub(crate) fn forget_actors_wanted(folder: &RunFolder) -> Result<()> {
    let file = folder.actors_file();
    match fs::remove_file(&file) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(error).with_context(|| file.display().to_string())
        }
        _ => Ok(()),
    }
}

fn parsed(text: &str, file: &Path) -> Result<u64> {
    let allowed = 1..=MAX_ACTORS as u64;
    let count = text.parse().ok().filter(|count| allowed.contains(count));
    count.with_context(|| {
        format!("{}: expected 1 to {MAX_ACTORS} actors, found {text:?}", file.display())
    })
}

/// The supervisor's view of the number wanted.
pub(super) struct ActorsWanted {
    file: PathBuf,
    known: Option<String>,
}

impl ActorsWanted {
    /// Nobody has wanted anything since the run was laid out.
    pub(super) fn new(folder: &RunFolder) -> ActorsWanted {
        ActorsWanted { file: folder.actors_file(), known: None }
    }

    /// The number wanted, if it has changed since the last look.
    ///
    /// # Errors
    /// When there is something else in the file.
    pub(super) fn changed(&mut self) -> Result<Option<u64>> {
        let Some(text) = beginning(&self.file) else { return Ok(None) };
        if self.known.as_ref() == Some(&text) {
            return Ok(None);
        }
        let count = parsed(&text, &self.file);
        // What is no number is said once.
        self.known = Some(text);
        count.map(Some)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wish_is_seen_once_and_can_be_forgotten() {
        let directory = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(directory.path());
        let mut wanted = ActorsWanted::new(&folder);
        assert_eq!(wanted.changed().unwrap(), None);
        assert_eq!(actors_wanted(&folder).unwrap(), None);
        want_actors(&folder, 3).unwrap();
        assert_eq!(wanted.changed().unwrap(), Some(3));
        assert_eq!(wanted.changed().unwrap(), None);
        assert_eq!(actors_wanted(&folder).unwrap(), Some(3));
        fs::write(folder.actors_file(), "many").unwrap();
        assert!(wanted.changed().unwrap_err().to_string().contains("found \"many\""));
        assert!(actors_wanted(&folder).unwrap_err().to_string().contains("found \"many\""));
        assert_eq!(wanted.changed().unwrap(), None, "said once");
        forget_actors_wanted(&folder).unwrap();
        forget_actors_wanted(&folder).unwrap();
        assert_eq!(actors_wanted(&folder).unwrap(), None);
    }

    #[test]
    fn any_bytes_are_a_number_or_a_line() {
        let directory = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(directory.path());
        for bytes in
            [&b""[..], b"-1", b"1e9", b"65", b"18446744073709551616", b"\xff\n\0", &[b'7'; 1 << 20]]
        {
            fs::write(folder.actors_file(), bytes).unwrap();
            let line = actors_wanted(&folder).unwrap_err().to_string();
            assert!(line.len() < 400 && !line.chars().any(char::is_control), "{line:?}");
        }
    }
}
