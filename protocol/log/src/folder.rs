//! The files of a run's log folder, and the room on its disk.
//!
//! Files are called `trajectories-00000.mcap`, `updates-00000.mcap` and so on, with `.active` at the end while they
//! are written. A number is used once, whatever became of the file.

use std::fs;
use std::path::{Path, PathBuf};

use protocol::{Error, durable};

use super::topic::Contents;
use super::{read_error, write_error};

/// Ending of a sealed file's name.
pub(super) const SEALED: &str = "mcap";
/// Ending that is added to a file's name until it is sealed.
pub(super) const ACTIVE: &str = "active";

/// A file of a run's log.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct LogFile {
    /// What it holds.
    pub contents: Contents,
    /// Its number among the files of the same contents.
    pub number: u32,
    /// Whether it is not sealed: being written, or left by a crash.
    pub active: bool,
    /// Where it is.
    pub path: PathBuf,
}

/// Returns the readable files of a log folder by contents and number. Files with other names are left out.
///
/// # Errors
/// [`Error::LogRead`] if the folder cannot be listed.
pub fn log_files(folder: &Path) -> Result<Vec<LogFile>, Error> {
    let mut files = Vec::new();
    for (name, path) in names(folder)? {
        let Some((contents, number, ending)) = parse(&name) else { continue };
        let active = match ending {
            "" => false,
            ending if ending.strip_prefix('.') == Some(ACTIVE) => true,
            _ => continue,
        };
        files.push(LogFile { contents, number, active, path });
    }
    files.sort();
    Ok(files)
}

/// Returns the first number that no file of these contents has had.
pub(super) fn next_number(folder: &Path, contents: Contents) -> Result<u32, Error> {
    let names = names(folder)?;
    let numbers = names.iter().filter_map(|(name, _)| parse(name));
    let last = numbers.filter(|&(found, ..)| found == contents).map(|(_, number, _)| number).max();
    Ok(last.map_or(0, |last| last + 1))
}

/// Returns whether a file's name says that it is not sealed.
pub fn is_active(path: &Path) -> bool {
    path.extension().is_some_and(|ending| ending == ACTIVE)
}

/// Returns whether a file has the name of one in a run's log, maybe with an ending added to it.
pub(super) fn is_of_run(path: &Path) -> bool {
    path.file_name().is_some_and(|name| parse(&name.to_string_lossy()).is_some())
}

/// Returns whether a living writer has the file that will be `path` when it is sealed.
pub fn is_being_written(path: &Path) -> bool {
    durable::is_locked(&with_ending(path, ACTIVE))
}

/// Returns the path of a file once it is sealed.
pub(super) fn path(folder: &Path, contents: Contents, number: u32) -> PathBuf {
    folder.join(format!("{}-{number:05}.{SEALED}", contents.name()))
}

/// Returns where the file is that was at `path` a moment ago: its writer may have sealed it since.
pub(super) fn followed(path: PathBuf) -> PathBuf {
    let sealed = path.with_extension("");
    let moved = is_active(&path) && !path.exists();
    if moved && sealed.exists() { sealed } else { path }
}

/// Returns `path` with `.ending` after its whole name.
pub(super) fn with_ending(path: &Path, ending: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".");
    name.push(ending);
    PathBuf::from(name)
}

/// Syncs the folder that `path` is in, so that renames and new files survive the death of the machine.
pub(super) fn sync_folder_of(path: &Path) -> Result<(), Error> {
    let folder = durable::folder_of(path);
    durable::sync_folder_of(path).map_err(|cause| write_error(folder, "sync the folder", &cause))
}

/// Refuses a folder whose disk has less than `bytes` free.
///
/// # Errors
/// [`Error::LogWrite`] if it has less, or the system does not say.
pub fn require_room(folder: &Path, bytes: u64) -> Result<(), Error> {
    let disk = rustix::fs::statvfs(folder)
        .map_err(|cause| write_error(folder, "ask for the room on the disk", &cause.into()))?;
    let free = disk.f_bavail.saturating_mul(disk.f_frsize);
    if free >= bytes {
        return Ok(());
    }
    let [needed, free] = [bytes, free].map(|bytes| bytes.div_ceil(1 << 20));
    let message = format!("no room on the disk: expected {needed} MiB free, found {free} MiB");
    Err(Error::LogWrite { path: folder.to_owned(), message })
}

fn names(folder: &Path) -> Result<Vec<(String, PathBuf)>, Error> {
    let failed = |cause| read_error(folder, format!("cannot list the folder: {cause}"));
    let entries = fs::read_dir(folder).map_err(failed)?;
    entries
        .map(|entry| {
            let entry = entry.map_err(failed)?;
            Ok((entry.file_name().to_string_lossy().into_owned(), entry.path()))
        })
        .collect()
}

/// Splits a file name into contents, number and what follows `.mcap`.
fn parse(name: &str) -> Option<(Contents, u32, &str)> {
    let contents = Contents::ALL.into_iter().find(|contents| name.starts_with(contents.name()))?;
    let rest = name.strip_prefix(contents.name())?.strip_prefix('-')?;
    let (number, rest) = rest.split_once('.')?;
    let ending = rest.strip_prefix(SEALED)?;
    Some((contents, number.parse().ok()?, ending))
}
