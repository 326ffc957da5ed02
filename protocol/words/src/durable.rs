//! Files and folders that others rely on: each is there as it was or as it is to be, never in part,
//! whatever dies meanwhile, this process or the machine.
//!
//! What is written has an ending of its own until it is whole and on the disk; then one rename puts
//! it in its place, and the folder is put on the disk, too. So a death leaves at most something with
//! that ending, which nobody reads and [`clear`] removes. A run's log has its own way, see
//! `mcap_log::FileWriter`.

use std::ffi::{OsStr, OsString};
use std::fs::{self, File, Permissions, TryLockError};
use std::io::{self, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use tempfile::TempDir;

/// Last part of the names of what is not finished.
const UNFINISHED: &str = "goalward-unfinished";

/// Who may read and write a new file, before the process' umask is applied.
const EVERYBODY: u32 = 0o666;

/// Who may read and write a private file.
const OWNER: u32 = 0o600;

/// Writes a file, in the place of the one that is there.
///
/// # Errors
/// When the disk refuses. The old file is then as it was, unless only its folder could not be synced.
pub fn write(path: &Path, bytes: impl AsRef<[u8]>) -> io::Result<()> {
    write_for(EVERYBODY, path, bytes.as_ref())
}

/// Writes a file that only this user can read.
///
/// # Errors
/// As [`write()`] has them.
pub fn write_private(path: &Path, bytes: impl AsRef<[u8]>) -> io::Result<()> {
    write_for(OWNER, path, bytes.as_ref())
}

fn write_for(whom: u32, path: &Path, bytes: &[u8]) -> io::Result<()> {
    let [prefix, suffix] = affixes(path);
    let mut file = tempfile::Builder::new()
        .prefix(&prefix)
        .suffix(&suffix)
        .permissions(Permissions::from_mode(whom))
        .tempfile_in(folder_of(path))?;
    // So that nobody takes it for abandoned.
    file.as_file().lock()?;
    file.write_all(bytes)?;
    file.as_file().sync_all()?;
    file.persist(path).map_err(|failed| failed.error)?;
    sync_folder_of(path)
}

/// Writes a file in the place of the one that is there, for what is soon replaced: nothing waits for the disk.
///
/// # Errors
/// When the file cannot be written; there is the earlier one then.
pub fn write_unsynced(path: &Path, bytes: impl AsRef<[u8]>) -> io::Result<()> {
    let unfinished = unfinished(path);
    fs::write(&unfinished, bytes)?;
    fs::rename(unfinished, path)
}

/// Makes a folder beside `path` for what is to become it or is soon done with; it goes with its last user.
///
/// # Errors
/// When the disk refuses.
pub fn temporary_folder(path: &Path) -> io::Result<TempDir> {
    let [prefix, suffix] = affixes(path);
    tempfile::Builder::new().prefix(&prefix).suffix(&suffix).tempdir_in(folder_of(path))
}

/// What is before and behind the random part of an unfinished name.
fn affixes(path: &Path) -> [OsString; 2] {
    let mut prefix = path.file_name().unwrap_or_default().to_owned();
    prefix.push(".");
    [prefix, format!(".{UNFINISHED}").into()]
}

/// Renames a file or folder that is on the disk, in the place of a file that is there.
///
/// # Errors
/// When the disk refuses.
pub fn rename(from: &Path, to: &Path) -> io::Result<()> {
    fs::rename(from, to)?;
    sync_folder_of(to)
}

/// Makes a folder, with those on the way to it.
///
/// # Errors
/// When the disk refuses, or something else has the name.
pub fn create_folder(path: &Path) -> io::Result<()> {
    if path.is_dir() {
        return Ok(());
    }
    create_folder(folder_of(path))?;
    match fs::create_dir(path) {
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists && path.is_dir() => {}
        made => made?,
    }
    sync_folder_of(path)
}

/// Removes a folder; one whose removal is cut off is not found under its name.
///
/// # Errors
/// When the disk refuses.
pub fn remove_folder(path: &Path) -> io::Result<()> {
    let unfinished = unfinished(path);
    rename(path, &unfinished)?;
    fs::remove_dir_all(unfinished)
}

/// The name of something until it is finished, for what is not written at once.
pub fn unfinished(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(format!(".{UNFINISHED}"));
    PathBuf::from(name)
}

/// Whether this is the name of something that is not finished.
pub fn is_unfinished(path: &Path) -> bool {
    path.extension() == Some(OsStr::new(UNFINISHED))
}

/// Removes from a folder what writers that died have left unfinished. A folder that is not there has
/// nothing.
///
/// # Errors
/// When it cannot be removed.
pub fn clear(folder: &Path) -> io::Result<()> {
    let entries = match fs::read_dir(folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        entries => entries?,
    };
    for entry in entries {
        let path = entry?.path();
        if is_unfinished(&path) {
            remove_abandoned(&path)?;
        }
    }
    Ok(())
}

fn remove_abandoned(path: &Path) -> io::Result<()> {
    let removed = if path.is_dir() {
        fs::remove_dir_all(path)
    } else if is_locked(path) {
        Ok(())
    } else {
        fs::remove_file(path)
    };
    match removed {
        // Its writer lives after all, and has just finished it.
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        removed => removed,
    }
}

/// Whether a process that lives holds the file's lock.
pub fn is_locked(path: &Path) -> bool {
    let Ok(file) = File::open(path) else { return false };
    matches!(file.try_lock_shared(), Err(TryLockError::WouldBlock))
}

/// Makes renames and new names of the folder that `path` is in outlive the machine's death.
///
/// # Errors
/// What the operating system says.
pub fn sync_folder_of(path: &Path) -> io::Result<()> {
    File::open(folder_of(path))?.sync_all()
}

/// The folder that `path` is in.
pub fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if folder != Path::new("") => folder,
        Some(_) => Path::new("."),
        None => path,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<OsString> {
        let mut names: Vec<_> =
            fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_file_is_replaced_and_everybody_may_read_it_who_could() {
        let folder = tempfile::tempdir().unwrap();
        let [path, plain] = ["file.txt", "plain.txt"].map(|name| folder.path().join(name));
        for text in ["old", "newer"] {
            write(&path, text).unwrap();
            assert_eq!(fs::read_to_string(&path).unwrap(), text);
        }
        fs::write(&plain, "").unwrap();
        let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode();
        assert_eq!(mode(&path), mode(&plain));
        assert_eq!(names(folder.path()), ["file.txt", "plain.txt"]);
        assert!(write(&folder.path().join("none/file.txt"), "").is_err());
    }

    #[test]
    fn what_is_abandoned_is_removed_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        for name in
            ["a", "a.unfinished", &format!("left.x.{UNFINISHED}"), &format!("held.{UNFINISHED}")]
        {
            fs::write(path(name), "").unwrap();
        }
        create_folder(&unfinished(&path("folder/000025"))).unwrap();
        create_folder(&unfinished(&path("000025")).join("inner")).unwrap();
        let held = File::open(path(&format!("held.{UNFINISHED}"))).unwrap();
        held.lock().unwrap();
        clear(folder.path()).unwrap();
        let held_name = format!("held.{UNFINISHED}");
        assert_eq!(names(folder.path()), ["a", "a.unfinished", "folder", &held_name]);
        drop(held);
        clear(folder.path()).unwrap();
        assert_eq!(names(folder.path()), ["a", "a.unfinished", "folder"]);
        remove_folder(&path("folder")).unwrap();
        assert_eq!(names(folder.path()).len(), 2);
        clear(&path("none")).unwrap();
    }
}
