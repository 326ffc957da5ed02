//! What the files of a run's log say of each other, for one whose own metadata is damaged.
//!
//! All files of a run have its task, its seed and what changes its results. Each time a run is started or resumed, it
//! begins files of both contents, with the same metadata.

use std::path::Path;

use protocol::{Error, durable};

use super::beginning;
use super::folder::{LogFile, followed, is_of_run, log_files};
use super::metadata::{Kind, Metadata};
use super::source::{Frame, Source, Tail};

/// Returns the files of a log whose metadata can be read and, as far as checksums show, is what was written. Only
/// metadata that no other file has is checked, because that takes reading the whole file.
///
/// # Errors
/// [`Error::LogRead`] if the folder cannot be listed.
pub(super) fn credible(folder: &Path) -> Result<Vec<(LogFile, Metadata)>, Error> {
    let read = |file: LogFile| {
        let path = followed(file.path);
        let (_, metadata) = beginning::read(&path).ok()?;
        Some((LogFile { path, ..file }, metadata))
    };
    let found: Vec<_> = log_files(folder)?.into_iter().filter_map(read).collect();
    let has_twin =
        |metadata: &Metadata| found.iter().filter(|(_, other)| other == metadata).count() > 1;
    let is_credible =
        |(file, metadata): &&(LogFile, Metadata)| has_twin(metadata) || !is_altered(&file.path);
    Ok(found.iter().filter(is_credible).cloned().collect())
}

/// Returns whether the checksum of a file's data is wrong. That of a file which is not sealed is not known.
fn is_altered(path: &Path) -> bool {
    let Ok(mut source) = Source::open(path) else { return false };
    loop {
        match source.next(path) {
            Ok(Frame::Record { .. }) => {}
            Ok(Frame::End(tail)) => return matches!(tail, Tail::Altered(_)),
            Err(_) => return false,
        }
    }
}

/// Returns what the other files of the log agree on, for a file whose metadata cannot be read; `None` if the file's
/// name is not that of a run's file, or no other file can be read, or they do not agree on task and seed.
pub(super) fn agreed(path: &Path) -> Option<Metadata> {
    common(others(path))
}

/// Returns the metadata to use for a file whose `own` may be damaged: its own if another file has the same, or if the
/// others do not help, else what the others agree on.
pub(super) fn settled(path: &Path, own: &Metadata) -> Metadata {
    let others = others(path);
    match others.contains(own) {
        true => own.clone(),
        false => common(others).unwrap_or_else(|| own.clone()),
    }
}

fn others(path: &Path) -> Vec<Metadata> {
    if !is_of_run(path) {
        return Vec::new();
    }
    let found = credible(durable::folder_of(path)).unwrap_or_default().into_iter();
    let is_other = |(file, metadata): &(LogFile, Metadata)| {
        metadata.kind == Kind::Run && file.path.file_name() != path.file_name()
    };
    found.filter(is_other).map(|(_, metadata)| metadata).collect()
}

fn common(all: Vec<Metadata>) -> Option<Metadata> {
    let common = all.into_iter().reduce(|mut common, next| {
        common.entries.retain(|name, value| next.get(name) == Some(value.as_str()));
        common
    })?;
    let tells_run = ["task", "seed"].iter().all(|name| common.get(name).is_some());
    tells_run.then_some(common)
}
