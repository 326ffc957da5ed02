//! The content and state of a log file, for `goalward log info`.

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};

use protocol::Error;

use super::folder::is_active;
use super::metadata::{Kind, Metadata};
use super::read_error;
use super::reader::{Ending, FileReader};
use super::topic::Topic;

/// What [`info`] found.
#[derive(Clone, Debug)]
pub struct FileInfo {
    /// The file.
    pub path: PathBuf,
    /// Whether its name says that it is not sealed: being written, or left by a dead writer.
    pub active: bool,
    /// How it ends. All checksums before that are right.
    pub ending: Ending,
    /// Its metadata.
    pub metadata: Metadata,
    /// Number of readable messages, for each topic that has any.
    pub messages: BTreeMap<Topic, u64>,
    /// Log times of the first and the last readable message, nanoseconds since 1970.
    pub span_ns: Option<(u64, u64)>,
    /// Bytes of the readable messages.
    pub raw_bytes: u64,
    /// Bytes of the file.
    pub file_bytes: u64,
}

/// Reads a whole file and returns what it holds; `None` if it ends before its metadata.
///
/// # Errors
/// As [`FileReader::open`]. A damaged file is no error: see [`FileInfo::ending`].
pub fn info(path: &Path) -> Result<Option<FileInfo>, Error> {
    let Some(mut reader) = FileReader::open_begun(path)? else { return Ok(None) };
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
    Ok(Some(FileInfo {
        path: path.to_owned(),
        active: is_active(path),
        ending: reader.ending().cloned().unwrap_or(Ending::Unsealed),
        metadata: reader.metadata().clone(),
        messages,
        span_ns,
        raw_bytes,
        file_bytes: file.len(),
    }))
}

impl FileInfo {
    /// In a word how it stands: sealed, being written, damaged.
    pub fn state(&self) -> &'static str {
        match (&self.ending, self.active) {
            (Ending::Complete, false) => "sealed",
            (Ending::Complete, true) => "sealed except for its name",
            (Ending::Unsealed, true) => "active",
            (Ending::Unsealed, false) => "not sealed",
            (Ending::Truncated { .. } | Ending::Corrupt { .. }, _) => "damaged",
        }
    }

    /// Returns the sizes of messages and file, and their ratio if the file is smaller. A file of few messages is
    /// mostly schemas and index, for which a ratio says nothing.
    fn sizes(&self) -> String {
        let (raw, file) = (self.raw_bytes, self.file_bytes);
        let part = match file < raw {
            true => format!(" ({:.1} %)", 100.0 * file as f64 / raw as f64),
            false => String::new(),
        };
        format!("{raw} bytes of messages in {file} bytes of file{part}")
    }
}

/// Several lines of text; the first is the file and its state.
impl fmt::Display for FileInfo {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(formatter, "{}: {}", self.path.display(), self.state())?;
        let of = |name| self.metadata.get(name).unwrap_or("unknown");
        let kind = self.metadata.kind.name();
        writeln!(formatter, "  {kind}, task {}, seed {}", of("task"), of("seed"))?;
        writeln!(formatter, "  by {}", self.metadata.build())?;
        for (topic, count) in &self.messages {
            let messages = if *count == 1 { "message" } else { "messages" };
            writeln!(formatter, "  {:<24}{count:>10} {messages}", topic.name())?;
        }
        // Demonstrations have numbers in place of log times.
        if let Some((first, last)) = self.span_ns.filter(|_| self.metadata.kind == Kind::Run) {
            let seconds = (last - first) as f64 / 1e9;
            writeln!(formatter, "  {seconds:.1} s from the first message to the last")?;
        }
        writeln!(formatter, "  {}", self.sizes())?;
        let checksums = if self.ending.lost() { "correct up to the damage" } else { "correct" };
        write!(formatter, "  checksums {checksums}; {}", self.ending)
    }
}
