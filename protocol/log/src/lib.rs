//! The log: how a run is kept, and where demonstrations and replays come from.
//!
//! Everything a run did is in MCAP files that any MCAP tool opens: the learner appends the bytes
//! that the actors published before it uses them. This is the only module that names mcap.
//!
//! | module | what it does |
//! |---|---|
//! | [`topic`] | topics, their schemas, which file they go to |
//! | [`metadata`] | the first record of every file: whose it is |
//! | [`file`](mod@file) | [`FileWriter`]: one file, from creation to sealing |
//! | [`writer`] | [`LogWriter`]: a run's folder; rotation and numbering |
//! | [`folder`] | names of a folder's files, room on the disk |
//! | `chunk` | chunks taken apart, within limits |
//! | `record` | records parsed, their lengths measured first |
//! | `source` | outermost records of a file |
//! | `summary` | the end of a sealed file, which says what it has |
//! | `scan` | bytes of a file to blocks of messages, whatever state the file is in |
//! | [`reader`] | [`FileReader`]: the records of one file and how it ends |
//! | [`run`] | [`read_run`]: all files of a run in order, each record once |
//! | `name` | what makes two records the same thing, recorded twice |
//! | `undone` | which records a run's going back to a checkpoint has undone |
//! | [`mod@rewrite`] | a run's log once more, with other trajectories |
//! | [`mod@info`] | what a file holds, for `goalward log info` |
//! | [`mod@repair`] | seals a file that a crash or a bad disk left, for `goalward log repair` |
//!
//! What a crash can lose: messages since the last [`LogWriter::flush`], at most one chunk (1 MiB)
//! and the message after it. What was flushed survives the death of the process; what was synced
//! survives the death of the machine. A full disk loses nothing, and one that fails to sync is told of for good:
//! see [`FileWriter`].
//!
//! What a file can cost who reads it: a record has 64 MiB at most, and a chunk taken apart has no more,
//! and 1,048,576 records at most; a file has no more than that and one record for every two bytes, and
//! grows to 10,000 times its length at most; a schema, a channel and the metadata have 1 MiB each. So a
//! reader holds one chunk: as it lies in the file, taken apart, and as messages.

mod batches;
mod chunk;
pub mod file;
pub mod folder;
pub mod info;
pub mod metadata;
mod name;
pub mod reader;
mod record;
pub mod repair;
pub mod rewrite;
pub mod run;
mod scan;
mod source;
mod summary;
pub mod topic;
mod undone;
pub mod writer;

pub use batches::Batches;
pub use file::{FileWriter, remove_abandoned};
pub use folder::{LogFile, is_active, is_being_written, log_files, require_room};
pub use info::{FileInfo, info};
pub use metadata::{Kind, Metadata};
pub use reader::{Ending, Entry, FileReader, Record};
pub use repair::{Repair, repair};
pub use rewrite::rewrite;
pub use run::{RunReader, read_contents, read_run, recorded_builds, recorded_metadata};
pub use topic::{Contents, Topic};
pub use writer::{LogOptions, LogWriter};

use std::io;
use std::path::Path;

use protocol::Error;
use protocol::dropped::shortened;
use protocol::error::MESSAGE_CHARS;

/// A failed write, in words that say what to do about it.
fn write_error(path: &Path, attempt: &str, cause: &io::Error) -> Error {
    use io::ErrorKind::{QuotaExceeded, StorageFull};
    let message = match cause.kind() {
        StorageFull | QuotaExceeded => format!("no room on the disk: cannot {attempt}: {cause}"),
        _ => format!("cannot {attempt}: {cause}"),
    };
    Error::LogWrite { path: path.to_owned(), message }
}

/// What cannot be read, in one line: names in a file are somebody else's words.
fn read_error(path: &Path, message: impl AsRef<str>) -> Error {
    let message = shortened(message.as_ref(), MESSAGE_CHARS);
    Error::LogRead { path: path.to_owned(), message }
}
