//! Atomic and durable writes of files and folders. Each exists either in its old or in its new form, never in part,
//! even if this process or the machine dies during a write.
//!
//! A file or folder has a name with a special ending until it is complete and synced. Then it is renamed, and its
//! parent folder is synced, too. A death thus leaves at most something with that ending, which nobody reads and
//! [`clear`] removes. A run's log works differently, see `mcap_log::FileWriter`.

use std::ffi::{OsStr, OsString};
use std::fs::{self, File, Metadata, Permissions, TryLockError};
use std::io::{self, Write};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::thread;
use std::time::Duration;

use tempfile::TempDir;

/// Ending of the names of unfinished files and folders.
const UNFINISHED: &str = "goalward-unfinished";

/// Name of the file in a temporary folder whose lock its process holds.
const LOCK: &str = "lock";

/// Number of attempts to take a lock, and the pause between them.
const LOCK_ATTEMPTS: u32 = 3;
const LOCK_PAUSE: Duration = Duration::from_millis(20);

/// Permissions of a new file, before the process's umask is applied.
const EVERYBODY: u32 = 0o666;

/// Permissions of a private file.
const OWNER: u32 = 0o600;

/// Writes a file, replacing an existing one.
///
/// # Errors
/// When writing fails. The old file is then unchanged, unless only syncing the folder failed.
pub fn write(path: &Path, bytes: impl AsRef<[u8]>) -> io::Result<()> {
    write_for(EVERYBODY, path, bytes.as_ref())
}

/// Writes a file that only this user can read.
///
/// # Errors
/// As [`write()`].
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
    // The lock shows that the file is not abandoned.
    file.as_file().lock()?;
    file.write_all(bytes)?;
    file.as_file().sync_all()?;
    file.persist(path).map_err(|failed| failed.error)?;
    sync_folder_of(path)
}

/// Writes a file that will soon be replaced, without syncing it. An existing file is replaced.
///
/// # Errors
/// When the file cannot be written. The earlier file is then unchanged.
pub fn write_unsynced(path: &Path, bytes: impl AsRef<[u8]>) -> io::Result<()> {
    let unfinished = unfinished(path);
    fs::write(&unfinished, bytes)?;
    fs::rename(unfinished, path)
}

/// A folder that is removed when this is dropped.
#[derive(Debug)]
pub struct TemporaryFolder {
    /// Shows that the folder is not abandoned. It is closed first: NFS removes no file that is open.
    _lock: File,
    folder: TempDir,
}

impl TemporaryFolder {
    /// Creates a folder beside `path`, for what is to become `path` or is needed only briefly. Those that dead
    /// processes left there for `path` are removed if they can be.
    ///
    /// # Errors
    /// When the folder cannot be created.
    pub fn beside(path: &Path) -> io::Result<TemporaryFolder> {
        let [prefix, suffix] = affixes(path);
        clear_where(folder_of(path), |found| is_temporary_of(&prefix, found)).ok();
        let mut named = tempfile::Builder::new();
        let folder = named.prefix(&prefix).suffix(&suffix).tempdir_in(folder_of(path))?;
        // The lock is held before it has its name: a folder with a lock that nobody holds counts as abandoned.
        let nameless = unfinished(&folder.path().join(LOCK));
        let lock = File::create(&nameless)?;
        lock.lock()?;
        fs::rename(nameless, folder.path().join(LOCK))?;
        Ok(TemporaryFolder { _lock: lock, folder })
    }

    /// Returns the path of the folder.
    pub fn path(&self) -> &Path {
        self.folder.path()
    }
}

/// Returns what comes before and after the random part of an unfinished name.
fn affixes(path: &Path) -> [OsString; 2] {
    let mut prefix = path.file_name().unwrap_or_default().to_owned();
    prefix.push(".");
    [prefix, format!(".{UNFINISHED}").into()]
}

/// Returns whether this is the name of a temporary folder beside a path whose unfinished names begin with `prefix`.
fn is_temporary_of(prefix: &OsStr, found: &Path) -> bool {
    let name = found.file_name().unwrap_or_default().as_bytes();
    let rest = name.strip_prefix(prefix.as_bytes());
    let random = rest.and_then(|rest| rest.strip_suffix(format!(".{UNFINISHED}").as_bytes()));
    // Other paths whose names begin alike have a dot in the rest.
    random.is_some_and(|random| !random.contains(&b'.')) && found.join(LOCK).is_file()
}

/// Copies a file, replacing an existing one.
///
/// # Errors
/// When copying fails. The old file is then unchanged, unless only syncing the folder failed.
pub fn copy(from: &Path, to: &Path) -> io::Result<()> {
    let unfinished = unfinished(to);
    fs::copy(from, &unfinished)?;
    File::open(&unfinished)?.sync_all()?;
    rename(&unfinished, to)
}

/// Renames a synced file or folder, replacing an existing file, and syncs the folder.
///
/// # Errors
/// When renaming or syncing fails.
pub fn rename(from: &Path, to: &Path) -> io::Result<()> {
    fs::rename(from, to)?;
    sync_folder_of(to)
}

/// Creates a folder and its missing parents, and syncs them.
///
/// # Errors
/// When the folder cannot be created, or something else has the name.
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

/// Removes a folder. If the removal is interrupted, what is left has an unfinished name.
///
/// # Errors
/// When the folder cannot be removed.
pub fn remove_folder(path: &Path) -> io::Result<()> {
    let unfinished = unfinished(path);
    rename(path, &unfinished)?;
    fs::remove_dir_all(unfinished)
}

/// Returns the name of a file or folder until it is finished, for what is not written in one go.
pub fn unfinished(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(format!(".{UNFINISHED}"));
    PathBuf::from(name)
}

/// Returns whether this is the name of something unfinished.
pub fn is_unfinished(path: &Path) -> bool {
    path.extension() == Some(OsStr::new(UNFINISHED))
}

/// Removes from a folder what dead writers left unfinished. A missing folder is no error.
///
/// # Errors
/// When the folder cannot be listed or something in it cannot be removed.
pub fn clear(folder: &Path) -> io::Result<()> {
    clear_where(folder, is_unfinished)
}

/// Removes from a folder what dead writers left under names that are `meant`.
fn clear_where(folder: &Path, meant: impl Fn(&Path) -> bool) -> io::Result<()> {
    let entries = match fs::read_dir(folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        entries => entries?,
    };
    for entry in entries {
        let path = entry?.path();
        if meant(&path) {
            remove_abandoned(&path)?;
        }
    }
    Ok(())
}

fn remove_abandoned(path: &Path) -> io::Result<()> {
    let removed = match path.is_dir() {
        true if is_locked(&path.join(LOCK)) => Ok(()),
        true => fs::remove_dir_all(path),
        false if is_locked(path) => Ok(()),
        false => fs::remove_file(path),
    };
    match removed {
        // Its writer is alive after all, and has just finished it.
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        removed => removed,
    }
}

/// Locks a file. Those who hold the lock only to see whether it is held, as [`is_locked`] does, are waited for.
///
/// # Errors
/// As [`File::try_lock`].
pub fn try_lock(file: &File) -> Result<(), TryLockError> {
    for _ in 1..LOCK_ATTEMPTS {
        match file.try_lock() {
            Err(TryLockError::WouldBlock) => thread::sleep(LOCK_PAUSE),
            tried => return tried,
        }
    }
    file.try_lock()
}

/// Returns whether a living process holds the file's lock.
pub fn is_locked(path: &Path) -> bool {
    let Ok(file) = File::open(path) else { return false };
    matches!(file.try_lock_shared(), Err(TryLockError::WouldBlock))
}

/// Syncs the folder that `path` is in, so that renames and new names survive the death of the machine.
///
/// # Errors
/// The operating system's error.
pub fn sync_folder_of(path: &Path) -> io::Result<()> {
    File::open(folder_of(path))?.sync_all()
}

/// Returns the device and inode number of a file, which it has under each of its paths.
pub fn identity(file: &Metadata) -> (u64, u64) {
    (file.dev(), file.ino())
}

/// Returns the folder that `path` is in.
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
        let used = TemporaryFolder::beside(&path("used")).unwrap();
        clear(folder.path()).unwrap();
        let held_name = OsString::from(format!("held.{UNFINISHED}"));
        assert_eq!(
            names(folder.path())[..4],
            ["a", "a.unfinished", "folder", held_name.to_str().unwrap()]
        );
        assert!(used.path().exists());
        drop((held, used));
        clear(folder.path()).unwrap();
        assert_eq!(names(folder.path()), ["a", "a.unfinished", "folder"]);
        remove_folder(&path("folder")).unwrap();
        assert_eq!(names(folder.path()).len(), 2);
        clear(&path("none")).unwrap();
    }

    #[test]
    fn a_temporary_folder_takes_the_place_of_those_that_dead_processes_left() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let [left, of_another] =
            ["out.x1", "out.mcap.x2"].map(|name| path(&format!("{name}.{UNFINISHED}")));
        for left in [&left, &of_another] {
            create_folder(left).unwrap();
            fs::write(left.join(LOCK), "").unwrap();
        }
        let begun = path(&format!("out.x3.{UNFINISHED}"));
        create_folder(&begun).unwrap();
        let [one, other] = [(); 2].map(|()| TemporaryFolder::beside(&path("out")).unwrap());
        assert!(!left.exists() && of_another.exists());
        assert!(one.path().exists() && other.path().exists() && one.path() != other.path());
        assert!(begun.exists(), "its process may be about to write the lock");
    }
}
