//! Files and folders that belong to this user alone. Shared memory is open to every user of the machine, so what is
//! found there is checked, without following links, before it is used.

use std::fs::{self, DirBuilder, Metadata, Permissions};
use std::io::ErrorKind;
use std::os::unix::fs::{DirBuilderExt, MetadataExt, PermissionsExt};
use std::path::Path;

use protocol::Error;

/// Permission bits of everybody but the owner.
const OTHERS: u32 = 0o077;

/// Creates a folder that only this user can enter, or accepts an existing one.
///
/// # Errors
/// When something else has its name, or it cannot be created.
pub(super) fn make_folder(path: &Path) -> Result<(), Error> {
    match DirBuilder::new().mode(0o700).create(path) {
        Err(error) if error.kind() == ErrorKind::AlreadyExists => check_folder(path).map(drop),
        made => made.map_err(|error| in_the_way(path, error.to_string())),
    }
}

/// Returns whether there is a folder that is private to this user.
///
/// # Errors
/// When something else has its name: a file, a link, a folder that others own or can enter.
pub(super) fn check_folder(path: &Path) -> Result<bool, Error> {
    let Some(found) = look(path)? else { return Ok(false) };
    let is_private = found.mode() & OTHERS == 0;
    if found.is_dir() && is_ours(&found) && is_private {
        return Ok(true);
    }
    let message = format!("expected a folder of this user alone, found {}", described(&found));
    Err(in_the_way(path, message))
}

/// Checks that a file, if there is one, belongs to this user.
///
/// # Errors
/// When it belongs to another user.
pub(super) fn check_owner(path: &Path) -> Result<(), Error> {
    match look(path)? {
        Some(found) if !is_ours(&found) => Err(in_the_way(
            path,
            format!("expected a file of this user, found {}", described(&found)),
        )),
        _ => Ok(()),
    }
}

/// Removes everybody else's access to a file of this user. Links and other users' files stay as they are.
///
/// # Errors
/// When the permissions cannot be changed.
pub(super) fn close_to_others(path: &Path) -> Result<(), Error> {
    let Some(found) = look(path)?.filter(|found| found.is_file() && is_ours(found)) else {
        return Ok(());
    };
    if found.mode() & OTHERS == 0 {
        return Ok(());
    }
    match fs::set_permissions(path, Permissions::from_mode(0o600)) {
        Err(error) if error.kind() != ErrorKind::NotFound => {
            Err(in_the_way(path, error.to_string()))
        }
        _ => Ok(()),
    }
}

/// Describes the owner of a file, for an error.
pub(super) fn owner(path: &Path) -> String {
    match fs::symlink_metadata(path) {
        Ok(found) => format!("it belongs to user {}", found.uid()),
        Err(_) => "its owner is not known".to_owned(),
    }
}

/// Returns the metadata of what is at `path`, without following links; `None` if nothing is.
fn look(path: &Path) -> Result<Option<Metadata>, Error> {
    match fs::symlink_metadata(path) {
        Ok(found) => Ok(Some(found)),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
        Err(error) => Err(in_the_way(path, error.to_string())),
    }
}

fn is_ours(found: &Metadata) -> bool {
    found.uid() == rustix::process::geteuid().as_raw()
}

fn described(found: &Metadata) -> String {
    let kind = match found.file_type() {
        kind if kind.is_dir() => "a folder",
        kind if kind.is_symlink() => "a link",
        kind if kind.is_file() => "a file",
        _ => "something else",
    };
    format!("{kind} of user {} with mode {:o}", found.uid(), found.mode() & 0o7777)
}

/// Returns the error for what blocks a start, with its path.
fn in_the_way(path: &Path, message: String) -> Error {
    Error::BusFile { path: path.to_owned(), message }
}
