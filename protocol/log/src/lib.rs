//! The log: how a run is recorded, and where demonstrations and replays come from.
//!
//! Everything a run did is in MCAP files that any MCAP tool can open. The learner appends the bytes that the actors
//! published before it uses them. Only this crate depends on mcap.
//!
//! | module | what it does |
//! |---|---|
//! | [`topic`] | topics, their schemas, which file they go to |
//! | `metadata` | the first record of every file: what the file is |
//! | [`file`](mod@file) | [`FileWriter`]: one file, from creation to sealing |
//! | `writer` | [`LogWriter`]: a run's folder; rotation and numbering |
//! | `folder` | names of a folder's files, room on the disk |
//! | `beginning` | the beginning of a file, which has no checksum of its own |
//! | `siblings` | what the files of a run say of each other, for one whose own metadata is damaged |
//! | `batches` | the batches a run learned from, while its log is read |
//! | `chunk` | unpacks chunks, within limits |
//! | `record` | parses records, after checking their lengths |
//! | `source` | top-level records of a file |
//! | `summary` | the summary at the end of a sealed file |
//! | `scan` | turns the bytes of a file into blocks of messages, whatever state the file is in |
//! | `reader` | [`FileReader`]: the records of one file and how it ends |
//! | `run` | [`read_run`]: all files of a run in order, each record once |
//! | `name` | the name of a record; records with the same name are the same thing, recorded twice |
//! | `undone` | which records a run has undone by going back to a checkpoint |
//! | `rewrite` | copies a run's log with other trajectories |
//! | `info` | what a file holds, for `goalward log info` |
//! | `repair` | seals a file that a crash or a bad disk left, for `goalward log repair` |
//!
//! What a crash can lose: messages since the last [`LogWriter::flush`], at most one chunk (1 MiB) and the message
//! after it. What was flushed survives the death of the process; what was synced survives the death of the machine. A
//! full disk loses nothing. A failed sync is an error for good: see [`FileWriter`].
//!
//! What a file can cost its reader: a record has at most 64 MiB. A chunk unpacks to at most as much, and to at most
//! 1,048,576 records. A file has at most that many records and one more for every two bytes, and grows to at most
//! 10,000 times its length and 64 MiB more. A schema, a channel and the metadata have at most 1 MiB each. So a reader
//! holds one chunk: packed, unpacked, and as messages.

mod batches;
mod beginning;
mod chunk;
pub mod file;
mod folder;
mod info;
mod metadata;
mod name;
mod reader;
mod record;
mod repair;
mod rewrite;
mod run;
mod scan;
mod siblings;
mod source;
mod summary;
pub mod topic;
mod undone;
mod writer;

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

/// Returns the error of a failed write. It says if the disk is full.
fn write_error(path: &Path, attempt: &str, cause: &io::Error) -> Error {
    use io::ErrorKind::{QuotaExceeded, StorageFull};
    let message = match cause.kind() {
        StorageFull | QuotaExceeded => format!("no room on the disk: cannot {attempt}: {cause}"),
        _ => format!("cannot {attempt}: {cause}"),
    };
    Error::LogWrite { path: path.to_owned(), message }
}

/// Returns the error of a failed read, in one short line: names in a file are foreign text.
fn read_error(path: &Path, message: impl AsRef<str>) -> Error {
    let message = shortened(message.as_ref(), MESSAGE_CHARS);
    Error::LogRead { path: path.to_owned(), message }
}
