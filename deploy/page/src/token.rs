//! The token that requests about runs need. It is kept for the user, so that open browsers reconnect to a page that was
//! started again.

use std::fs::{DirBuilder, File};
use std::io::{self, ErrorKind, Read, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt};
use std::path::{Path, PathBuf};

use tempfile::NamedTempFile;

/// Number of random bytes in a token, which has two hexadecimal digits for each.
const BYTES: usize = 16;

/// Name of the file with the token.
const FILE: &str = "page-token";

/// Permissions of the folder with the token.
const OWNER: u32 = 0o700;

/// The permission bits that a file has only if others than its owner may use it.
const OTHERS: u32 = 0o077;

/// Returns the token that is kept for this user; a new one if none can be kept or others may know it.
///
/// # Errors
/// When the system's random numbers cannot be read.
pub(crate) fn of_user() -> io::Result<String> {
    let kept = folder().and_then(|folder| kept_in(&folder).ok());
    kept.map_or_else(random, Ok)
}

/// Returns the folder for a program's state in the home of this user; `None` if the user has no home.
fn folder() -> Option<PathBuf> {
    let named = |name| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    let state = named("XDG_STATE_HOME").or_else(|| Some(named("HOME")?.join(".local/state")));
    Some(state?.join("goalward"))
}

/// Returns the token in a folder. If there is none yet, one is put there.
///
/// # Errors
/// When it cannot be read or written, others may know it, or the file has something else.
fn kept_in(folder: &Path) -> io::Result<String> {
    let file = folder.join(FILE);
    match read(&file) {
        Err(error) if error.kind() == ErrorKind::NotFound => {}
        found => return found,
    }
    DirBuilder::new().recursive(true).mode(OWNER).create(folder)?;
    // A temporary file is its owner's alone.
    let mut new = NamedTempFile::new_in(folder)?;
    writeln!(new, "{}", random()?)?;
    new.as_file().sync_all()?;
    // If another page was faster, its token counts.
    new.persist_noclobber(&file).ok();
    read(&file)
}

fn read(path: &Path) -> io::Result<String> {
    let mut file = File::open(path)?;
    let found = file.metadata()?;
    let mut text = String::new();
    file.read_to_string(&mut text)?;
    let token = text.trim_end();
    let is_users = found.uid() == rustix::process::geteuid().as_raw();
    let is_own = is_users && found.mode() & OTHERS == 0;
    let is_token = token.len() == 2 * BYTES && token.bytes().all(|digit| digit.is_ascii_hexdigit());
    if is_own && is_token { Ok(token.to_owned()) } else { Err(ErrorKind::InvalidData.into()) }
}

fn random() -> io::Result<String> {
    let mut bytes = [0; BYTES];
    File::open("/dev/urandom")?.read_exact(&mut bytes)?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

#[cfg(test)]
mod tests {
    use std::fs::{self, Permissions};
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    #[test]
    fn a_token_is_kept_where_only_its_owner_finds_it() {
        let directory = tempfile::tempdir().unwrap();
        let folder = directory.path().join("state/goalward");
        let token = kept_in(&folder).unwrap();
        assert_eq!(kept_in(&folder).unwrap(), token);
        let mode = |path: &Path| fs::metadata(path).unwrap().mode() & 0o777;
        assert_eq!((mode(&folder), mode(&folder.join(FILE))), (0o700, 0o600));
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 1, "nothing else is left");
        assert_ne!(kept_in(directory.path()).unwrap(), token);
    }

    #[test]
    fn a_file_that_others_may_know_or_that_has_no_token_is_not_used() {
        let directory = tempfile::tempdir().unwrap();
        let file = directory.path().join(FILE);
        let token = kept_in(directory.path()).unwrap();
        for (text, mode) in [
            (token.as_str(), 0o640),
            (token.as_str(), 0o604),
            ("", 0o600),
            (&token[1..], 0o600),
            ("a token of thirty-two characters", 0o600),
        ] {
            fs::write(&file, text).unwrap();
            fs::set_permissions(&file, Permissions::from_mode(mode)).unwrap();
            assert!(kept_in(directory.path()).is_err(), "{text}, {mode:o}");
            assert_eq!(fs::read_to_string(&file).unwrap(), text, "it stays as it is");
        }
        assert!(kept_in(&file).is_err(), "a folder that cannot be made");
    }
}
