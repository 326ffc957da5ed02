//! How many actors a machine of a run is to have, which can change while it trains.
//!
//! The number wanted is a file in the run's folder, one for the machine that learns and one for each other:
//! `goalward scale` writes it, the supervisor or the gateway looks at it; a run that is continued has its own
//! in its configuration. Whether it is seen sooner or later, and who runs which lease, changes no result.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, Read};
use std::path::PathBuf;

use protocol::dropped::shortened;
use protocol::error::{Error, FOUND_CHARS};
use protocol::{MAX_ACTORS, durable};

use crate::folder::RunFolder;

/// Most bytes looked at.
const MOST_BYTES: u64 = 32;

/// The number of actors that is wanted of a machine.
#[derive(Clone, Debug)]
pub struct ActorsWanted {
    file: PathBuf,
    /// What was there at the last look.
    known: Option<String>,
}

impl ActorsWanted {
    /// Of the machine that has the folder.
    pub fn here(folder: &RunFolder) -> ActorsWanted {
        ActorsWanted { file: folder.actors_file(), known: None }
    }

    /// Of another machine of the run.
    pub fn of_host(folder: &RunFolder, host: &str) -> ActorsWanted {
        ActorsWanted { file: folder.actors_file_of(host), known: None }
    }

    /// So many are wanted from now on.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn want(&self, count: u64) -> Result<(), Error> {
        durable::write(&self.file, count.to_string()).map_err(|error| self.failed(&error))
    }

    /// The number wanted, if there is one.
    ///
    /// # Errors
    /// When there is something else in the file.
    pub fn count(&self) -> Result<Option<u64>, Error> {
        self.beginning().map(|text| self.parsed(&text)).transpose()
    }

    /// The number wanted, if it has changed since the last look.
    ///
    /// # Errors
    /// When there is something else in the file; said once.
    pub fn changed(&mut self) -> Result<Option<u64>, Error> {
        let Some(text) = self.beginning() else { return Ok(None) };
        if self.known.as_ref() == Some(&text) {
            return Ok(None);
        }
        let count = self.parsed(&text);
        self.known = Some(text);
        count.map(Some)
    }

    /// The number wanted, which nobody finds after that.
    ///
    /// # Errors
    /// As [`ActorsWanted::count`], or when the file cannot be taken away.
    pub fn take(&self) -> Result<Option<u64>, Error> {
        // What is wanted from now on comes under the name again.
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

    /// Forgets it: who looks next knows it.
    ///
    /// # Errors
    /// When the file cannot be removed.
    pub fn forget(&self) -> Result<(), Error> {
        match fs::remove_file(&self.file) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(self.failed(&error)),
            _ => Ok(()),
        }
    }

    /// As much of the file as a number could have; none if there is no file.
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
