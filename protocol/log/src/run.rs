//! [`read_run`]: everything a run recorded, in order, each record once.
//!
//! A run that went back to a checkpoint, because a process died or it was resumed, has recorded some iterations twice.
//! The later record counts. While there is none yet, the earlier one does not count either: it was undone. Which
//! record is the last of its name is known only at the end, so the files are read twice: for the names, and for the
//! records.

use std::collections::{BTreeMap, VecDeque};
use std::path::{Path, PathBuf};

use protocol::Error;
use protocol::build::Build;
use protocol::table::{MODULES, result_differences};
use toml::Table;

use super::folder::{LogFile, followed, log_files};
use super::metadata::Metadata;
use super::name::{Name, name_of};
use super::reader::{Ending, Entry, FileReader, cut_off, decode};
use super::scan::Message;
use super::siblings::{credible, settled};
use super::topic::Contents;
use super::undone::{Mark, Return};
use super::{Kind, read_error};

/// Reads everything in a run's log folder: trajectories, scores, updates and checkpoints merged by log time. A policy
/// update comes after the trajectories it learned from. Damage of a file, also of its beginning, is no error: see
/// [`RunReader::endings`].
///
/// # Errors
/// [`Error::LogRead`] as [`FileReader::open`], or if the folder has no log or the logs of two runs.
pub fn read_run(folder: &Path) -> Result<RunReader, Error> {
    RunReader::open(folder, &Contents::ALL)
}

/// Reads only trajectories and scores, or only updates and checkpoints. Trajectories are the first to show that a run
/// went back. Read without them, undone updates count until the run has made the first of them again.
///
/// # Errors
/// As [`read_run`].
pub fn read_contents(folder: &Path, contents: Contents) -> Result<RunReader, Error> {
    RunReader::open(folder, &[contents])
}

/// Iterates over the records of a run; items fail as those of [`FileReader`] do.
pub struct RunReader {
    metadata: Metadata,
    streams: Vec<Stream>,
    endings: Vec<(PathBuf, Ending)>,
    left_out: u64,
    failed: bool,
}

impl RunReader {
    fn open(folder: &Path, contents: &[Contents]) -> Result<Self, Error> {
        let mut metadata: Option<Metadata> = None;
        let mut doubted: Option<Metadata> = None;
        let mut endings = Vec::new();
        let mut streams = Vec::new();
        let mut marks = Vec::new();
        let mut recorded = 0;
        // Updates first: what those of a live run have learned from was written before them.
        for &contents in contents.iter().rev() {
            let mut last = BTreeMap::new();
            let mut files = VecDeque::new();
            let found = log_files(folder)?;
            for file in found.into_iter().filter(|file| file.contents == contents) {
                let path = followed(file.path);
                let Some(mut reader) = FileReader::open_begun(&path)? else {
                    let bytes = path.metadata().map_or(0, |file| file.len());
                    endings.push((path.clone(), cut_off(&path, bytes, bytes)));
                    continue;
                };
                recorded +=
                    last_of_each_name(&path, &mut reader, files.len(), &mut last, &mut marks)?;
                let found = reader.metadata();
                expect_run(&path, found)?;
                // Damaged metadata is no reason to refuse the other files, and no measure of them.
                if reader.doubts_metadata() {
                    doubted = doubted.or_else(|| Some(settled(&path, found)));
                } else {
                    let first = metadata.get_or_insert_with(|| found.clone());
                    same_run(&path, first, found)?;
                }
                let ending = reader.ending().cloned().unwrap_or(Ending::Unsealed);
                endings.push((path.clone(), ending));
                files.push_back(path);
            }
            streams.push(Stream { files, opened: 0, reader: None, read: 0, last, head: None });
        }
        streams.reverse();
        endings.sort_by(|(one, _), (other, _)| one.cmp(other));
        let metadata = metadata.or(doubted).ok_or_else(|| nothing_to_read(folder, &endings))?;
        let returns = Return::all(marks);
        let is_undone = |name: &Name, place: &Place| {
            returns.iter().any(|back| back.undoes(name, place.log_time_ns))
        };
        let names = streams.iter_mut().map(|stream| {
            stream.last.retain(|name, place| !is_undone(name, place));
            stream.last.len() as u64
        });
        let left_out = recorded - names.sum::<u64>();
        let mut reader = RunReader { metadata, streams, endings, left_out, failed: false };
        reader.streams.iter_mut().try_for_each(Stream::advance)?;
        Ok(reader)
    }

    /// Returns the metadata of the run's first file whose metadata is not known to be damaged.
    pub fn metadata(&self) -> &Metadata {
        &self.metadata
    }

    /// Returns every file that was read, and how it ends.
    pub fn endings(&self) -> &[(PathBuf, Ending)] {
        &self.endings
    }

    /// Returns the number of records left out because they were recorded again later, or were undone.
    pub fn left_out(&self) -> u64 {
        self.left_out
    }

    /// Returns the number of trajectories that count, of training and of evaluation, wherever the iteration is.
    pub fn trajectories(&self) -> u64 {
        let names = self.streams.iter().flat_map(|stream| stream.last.keys());
        names.filter(|(topic, ..)| topic.is_of_trajectories()).count() as u64
    }

    /// Returns the next message, undecoded, with the file it is from; `None` at the end.
    pub(super) fn next_message(&mut self) -> Result<Option<(PathBuf, Message)>, Error> {
        let heads = self.streams.iter_mut().filter(|stream| stream.head.is_some());
        let earliest =
            heads.min_by_key(|stream| stream.head.as_ref().map(|(_, head)| head.log_time_ns));
        let Some(stream) = earliest else { return Ok(None) };
        let head = stream.head.take();
        stream.advance()?;
        Ok(head)
    }

    fn next_entry(&mut self) -> Result<Option<Entry>, Error> {
        let Some((path, message)) = self.next_message()? else { return Ok(None) };
        decode(&path, message).map(Some)
    }
}

impl Iterator for RunReader {
    type Item = Result<Entry, Error>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.failed {
            return None;
        }
        let entry = self.next_entry().transpose();
        self.failed = matches!(entry, Some(Err(_)));
        entry
    }
}

/// Where a record is, and when it was written.
struct Place {
    /// Number of the file.
    file: usize,
    /// Number of the record in the file.
    record: u64,
    log_time_ns: u64,
}

/// The files of one contents, one after another.
struct Stream {
    files: VecDeque<PathBuf>,
    opened: usize,
    reader: Option<(PathBuf, FileReader)>,
    /// Number of messages read from the open file.
    read: u64,
    last: BTreeMap<Name, Place>,
    head: Option<(PathBuf, Message)>,
}

impl Stream {
    /// Puts the next message that counts into `head`.
    fn advance(&mut self) -> Result<(), Error> {
        loop {
            let Some((path, reader)) = &mut self.reader else {
                let Some(path) = self.files.pop_front().map(followed) else { return Ok(()) };
                let reader = FileReader::open(&path)?;
                (self.opened, self.read) = (self.opened + 1, 0);
                self.reader = Some((path, reader));
                continue;
            };
            let Some(message) = reader.next_message()? else {
                self.reader = None;
                continue;
            };
            let (file, record) = (self.opened - 1, self.read);
            self.read += 1;
            let last = self.last.get(&name_of(path, &message)?);
            if last.is_some_and(|last| (last.file, last.record) == (file, record)) {
                self.head = Some((path.clone(), message));
                return Ok(());
            }
        }
    }
}

/// Notes where each record of a file is, in place of earlier records of the same name. Returns the number of records.
fn last_of_each_name(
    path: &Path,
    reader: &mut FileReader,
    file: usize,
    last: &mut BTreeMap<Name, Place>,
    marks: &mut Vec<Mark>,
) -> Result<u64, Error> {
    let mut record = 0;
    while let Some(message) = reader.next_message()? {
        let (name, log_time_ns) = (name_of(path, &message)?, message.log_time_ns);
        marks.extend(Mark::of(&name, log_time_ns));
        last.insert(name, Place { file, record, log_time_ns });
        record += 1;
    }
    Ok(record)
}

/// Returns the error for a log of which no file has metadata. Names the first of the files, if there are any.
fn nothing_to_read(folder: &Path, endings: &[(PathBuf, Ending)]) -> Error {
    match endings.first() {
        Some((path, ending)) => {
            let message = format!("expected metadata as the first record, found none: {ending}");
            read_error(path, message)
        }
        None => read_error(folder, "expected files such as trajectories-00000.mcap, found none"),
    }
}

fn expect_run(path: &Path, metadata: &Metadata) -> Result<(), Error> {
    if metadata.kind == Kind::Run {
        return Ok(());
    }
    let (expected, found) = (Kind::Run.name(), metadata.kind.name());
    Err(read_error(path, format!("expected metadata `{expected}`, found `{found}`")))
}

fn same_run(path: &Path, first: &Metadata, metadata: &Metadata) -> Result<(), Error> {
    for name in ["task", "seed"] {
        let [expected, found] = [first, metadata].map(|file| file.get(name).unwrap_or("none"));
        if expected != found {
            let message =
                format!("expected {name} {expected} as in the run's first file, found {found}");
            return Err(read_error(path, message));
        }
    }
    if first.get("config") == metadata.get("config") {
        return Ok(());
    }
    let (Some(expected), Some(found)) = (first.get("config"), metadata.get("config")) else {
        return Ok(());
    };
    let table = |text: &str| {
        let failed = |error: toml::de::Error| {
            read_error(path, format!("configuration of the log: {}", error.message()))
        };
        text.parse::<Table>().map_err(failed)
    };
    let differing = result_differences(&table(expected)?, &table(found)?);
    let is_checked = |(key, _): &&(String, _)| !key.starts_with(MODULES);
    let Some((key, [expected, found])) = differing.iter().find(is_checked) else { return Ok(()) };
    let message = format!("expected {key} = {expected} as in the run's first file, found {found}");
    Err(read_error(path, message))
}

/// Returns the metadata of the files of a run's log, by contents and number. Files whose metadata cannot be read, or is
/// known to be damaged, are left out.
///
/// # Errors
/// [`Error::LogRead`] if the folder cannot be listed.
pub fn recorded_metadata(folder: &Path) -> Result<Vec<Metadata>, Error> {
    Ok(credible(folder)?.into_iter().map(|(_, metadata)| metadata).collect())
}

/// Returns the builds that a run was trained by, one after another, as far as the files of its log show.
///
/// # Errors
/// [`Error::LogRead`] if the folder cannot be listed.
pub fn recorded_builds(folder: &Path) -> Result<Vec<Build>, Error> {
    let mut builds = Vec::new();
    // Each writer of a log begins a file of each contents.
    let is_of_updates = |(file, _): &(LogFile, Metadata)| file.contents == Contents::Updates;
    for (_, metadata) in credible(folder)?.into_iter().filter(is_of_updates) {
        let build = metadata.build();
        if builds.last() != Some(&build) {
            builds.push(build);
        }
    }
    Ok(builds)
}
