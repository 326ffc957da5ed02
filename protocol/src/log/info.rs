//! What a log file holds and in which state it is, for `goalward log info`.

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};

use super::folder::ACTIVE;
use super::metadata::Metadata;
use super::read_error;
use super::reader::{Ending, FileReader};
use super::topic::Topic;
use crate::Error;

/// What [`info`] found.
#[derive(Clone, Debug)]
pub struct FileInfo {
    /// The file.
    pub path: PathBuf,
    /// Whether its name says that it is being written, or its writer died.
    pub active: bool,
    /// How it ends; every checksum before that is right.
    pub ending: Ending,
    /// What it says of itself.
    pub metadata: Metadata,
    /// Readable messages of each topic that has any.
    pub messages: BTreeMap<Topic, u64>,
    /// Log times of the first and the last readable message, nanoseconds since 1970.
    pub span_ns: Option<(u64, u64)>,
    /// Bytes of the readable messages.
    pub raw_bytes: u64,
    /// Bytes of the file.
    pub file_bytes: u64,
}

/// Reads all of a file and says what it holds.
///
/// # Errors
/// As [`FileReader::open`]. A damaged file is no error: see [`FileInfo::ending`].
pub fn info(path: &Path) -> Result<FileInfo, Error> {
    let mut reader = FileReader::open(path)?;
    let file = path.metadata().map_err(|cause| read_error(path, cause.to_string()))?;
    let (mut messages, mut raw_bytes) = (BTreeMap::new(), 0);
    let mut span_ns: Option<(u64, u64)> = None;
    while let Some(message) = reader.next_message()? {
        *messages.entry(message.topic).or_insert(0) += 1;
        raw_bytes += message.bytes.len() as u64;
        let time = message.log_time_ns;
        let (first, last) = span_ns.unwrap_or((time, time));
        span_ns = Some((first.min(time), last.max(time)));
    }
    Ok(FileInfo {
        path: path.to_owned(),
        active: path.extension().is_some_and(|ending| ending == ACTIVE),
        ending: reader.ending().cloned().unwrap_or(Ending::Unsealed),
        metadata: reader.metadata().clone(),
        messages,
        span_ns,
        raw_bytes,
        file_bytes: file.len(),
    })
}

impl FileInfo {
    fn state(&self) -> &'static str {
        match (&self.ending, self.active) {
            (Ending::Complete, false) => "sealed",
            (Ending::Complete, true) => "sealed but for its name",
            (Ending::Unsealed, true) => "active",
            (Ending::Unsealed, false) => "not sealed",
            (Ending::Truncated { .. } | Ending::Corrupt { .. }, _) => "damaged",
        }
    }
}

/// Several lines of text; the first is the file and its state.
impl fmt::Display for FileInfo {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(formatter, "{}: {}", self.path.display(), self.state())?;
        let of = |name| self.metadata.get(name).unwrap_or("unknown");
        let kind = self.metadata.kind.name();
        writeln!(formatter, "  {kind}, task {}, seed {}", of("task"), of("seed"))?;
        for (topic, count) in &self.messages {
            writeln!(formatter, "  {:<24}{count:>10} messages", topic.name())?;
        }
        if let Some((first, last)) = self.span_ns {
            let seconds = (last - first) as f64 / 1e9;
            writeln!(formatter, "  {seconds:.1} s from the first message to the last")?;
        }
        let share = 100.0 * self.file_bytes as f64 / (self.raw_bytes as f64).max(1.0);
        let (raw, file) = (self.raw_bytes, self.file_bytes);
        writeln!(formatter, "  {raw} bytes of messages in {file} bytes of file ({share:.1} %)")?;
        let checksums = if self.ending.lost() { "right up to the damage" } else { "right" };
        write!(formatter, "  checksums {checksums}; {}", self.ending)
    }
}
