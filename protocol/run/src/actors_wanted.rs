//! How many actors each machine of a run should have, which can change during training.
//!
//! The number is in a file of the run's folder, one for the machine that learns and one for each
//! other machine. `goalward scale` writes it; the supervisor or the gateway reads it. When a run is
//! resumed, the number of the machine that learns becomes part of its configuration. When a change
//! is noticed, and which actor runs which lease, changes no result.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, Read};
use std::path::PathBuf;

use protocol::dropped::shortened;
use protocol::error::{Error, FOUND_CHARS};
use protocol::{MAX_ACTORS, durable};

use crate::folder::RunFolder;

/// Most bytes read from a file.
const MOST_BYTES: u64 = 32;

/// A handle to the number of actors wanted on a machine.
#[derive(Clone, Debug)]
pub struct ActorsWanted {
    file: PathBuf,
    /// Text of the file at the last look.
    known: Option<String>,
}

impl ActorsWanted {
    /// Returns the handle of the machine that has the folder.
    pub fn here(folder: &RunFolder) -> ActorsWanted {
        ActorsWanted { file: folder.actors_file(), known: None }
    }

    /// Returns the handle of another machine of the run.
    pub fn of_host(folder: &RunFolder, host: &str) -> ActorsWanted {
        ActorsWanted { file: folder.actors_file_of(host), known: None }
    }

    /// Asks for `count` actors from now on.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn want(&self, count: u64) -> Result<(), Error> {
        durable::write(&self.file, count.to_string()).map_err(|error| self.failed(&error))
    }

    /// Returns the number wanted, if there is one.
    ///
    /// # Errors
    /// If the file holds anything else.
    pub fn count(&self) -> Result<Option<u64>, Error> {
        self.beginning().map(|text| self.parsed(&text)).transpose()
    }

    /// Returns the number wanted, if it has changed since the last look.
    ///
    /// # Errors
    /// If the file holds anything else; reported once.
    pub fn changed(&mut self) -> Result<Option<u64>, Error> {
        let Some(text) = self.beginning() else { return Ok(None) };
        if self.known.as_ref() == Some(&text) {
            return Ok(None);
        }
        let count = self.parsed(&text);
        self.known = Some(text);
        count.map(Some)
    }

    /// Takes the number of the last look back, which cannot be had: `count` actors stay, which is no change. A newer
    /// number stays, too.
    ///
    /// # Errors
    /// As [`ActorsWanted::want`].
    pub fn refuse(&mut self, count: u64) -> Result<(), Error> {
        if self.known != self.beginning() {
            return Ok(());
        }
        self.want(count)?;
        self.known = Some(count.to_string());
        Ok(())
    }

    /// Returns the number wanted and removes the file.
    ///
    /// # Errors
    /// As [`ActorsWanted::count`], or if the file cannot be renamed or removed.
    pub fn take(&self) -> Result<Option<u64>, Error> {
        // After the renaming, a new number goes into a new file of the old name.
        let mut name = OsString::from("taken-");
        name.push(self.file.file_name().unwrap_or_default());
        let taken = ActorsWanted { file: self.file.with_file_name(name), known: None };
        match fs::rename(&self.file, &taken.file) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            renamed => renamed.map_err(|error| self.failed(&error))?,
        }
        let count = taken.count();
        taken.forget()?;
        count
    }

    /// Removes the file, if there is one, for callers that have adopted the number.
    ///
    /// # Errors
    /// If the file cannot be removed.
    pub fn forget(&self) -> Result<(), Error> {
        match fs::remove_file(&self.file) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(self.failed(&error)),
            _ => Ok(()),
        }
    }

    /// Reads as much of the file as a number could take; `None` if there is no file.
    fn beginning(&self) -> Option<String> {
        let mut bytes = Vec::new();
        File::open(&self.file).ok()?.take(MOST_BYTES).read_to_end(&mut bytes).ok()?;
        Some(String::from_utf8_lossy(&bytes).into_owned())
    }

    fn parsed(&self, text: &str) -> Result<u64, Error> {
        let count = text.parse().ok().filter(|count| (0..=MAX_ACTORS as u64).contains(count));
        count.ok_or_else(|| {
            let found = shortened(&format!("{text:?}"), FOUND_CHARS);
            self.failed(&format!("expected 0 to {MAX_ACTORS} actors, found {found}"))
        })
    }

    fn failed(&self, message: &impl ToString) -> Error {
        Error::ActorsWanted { path: self.file.clone(), message: message.to_string() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wish_is_seen_once_and_can_be_forgotten() {
        let directory = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(directory.path());
        let (mut wanted, of_host) =
            (ActorsWanted::here(&folder), ActorsWanted::of_host(&folder, "node-7"));
        assert_eq!((wanted.changed().unwrap(), wanted.count().unwrap()), (None, None));
        wanted.want(3).unwrap();
        assert_eq!((wanted.changed().unwrap(), wanted.changed().unwrap()), (Some(3), None));
        assert_eq!((wanted.count().unwrap(), of_host.count().unwrap()), (Some(3), None));
        fs::create_dir(folder.output()).unwrap();
        of_host.want(4).unwrap();
        assert_eq!((of_host.take().unwrap(), of_host.take().unwrap()), (Some(4), None));
        assert_eq!(fs::read_dir(folder.output()).unwrap().count(), 0);
        fs::write(folder.actors_file(), "many").unwrap();
        assert!(wanted.changed().unwrap_err().to_string().contains("found \"many\""));
        assert!(wanted.count().unwrap_err().to_string().contains("found \"many\""));
        assert_eq!(wanted.changed().unwrap(), None, "said once");
        wanted.refuse(3).unwrap();
        assert_eq!((wanted.changed().unwrap(), wanted.count().unwrap()), (None, Some(3)));
        wanted.forget().unwrap();
        wanted.forget().unwrap();
        assert_eq!(wanted.count().unwrap(), None);
    }

    #[test]
    fn any_bytes_are_a_number_or_a_line() {
        let directory = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(directory.path());
        for bytes in
            [&b""[..], b"-1", b"1e9", b"65", b"18446744073709551616", b"\xff\n\0", &[b'7'; 1 << 20]]
        {
            fs::write(folder.actors_file(), bytes).unwrap();
            let line = ActorsWanted::here(&folder).count().unwrap_err().to_string();
            assert!(line.len() < 400 && !line.chars().any(char::is_control), "{line:?}");
        }
    }
}
