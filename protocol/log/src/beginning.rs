//! The beginning of a file: what comes before its first chunk, which is magic, header and metadata.
//!
//! Chunks have checksums of their own. For the beginning there is only the checksum of all data, at the end of a sealed
//! file.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use mcap::records::{Record, op};
use protocol::Error;

use super::chunk::RECORD_HEADER;
use super::metadata::{Metadata, not_ours};
use super::read_error;
use super::record::{self, LONGEST_DECLARATION, Trouble};
use super::source::{Frame, Source, Tail};

/// Maximum length of a beginning, in bytes: header and metadata have no more each.
const LONGEST: u64 = 2 * LONGEST_DECLARATION as u64;

/// The length and the name of the compression of our chunks, and where they are in the content of a chunk. The length
/// of the packed data follows, and then the data.
const COMPRESSION: &[u8] = b"\x04\0\0\0zstd";
const COMPRESSION_AT: usize = 28;

/// The reason why a beginning is not accepted.
pub(super) enum Refusal {
    /// The file ends before its metadata, or a record says that it is longer than the file.
    Cut,
    /// It is damaged, or of no file of ours.
    Damage(Error),
    /// It is intact, but this build cannot read such files.
    Foreign(Error),
}

impl From<Error> for Refusal {
    fn from(error: Error) -> Self {
        Refusal::Damage(error)
    }
}

/// Opens a file and reads its metadata. What comes next is its first chunk.
pub(super) fn read(path: &Path) -> Result<(Source, Metadata), Refusal> {
    let mut source = Source::open(path)?;
    match source.next(path)? {
        Frame::Record { kind: op::HEADER, .. } => {}
        Frame::End(Tail::Unsealed | Tail::Cut { .. }) => return Err(Refusal::Cut),
        _ => {
            let message = "expected an MCAP header first, found something else";
            return Err(read_error(path, message).into());
        }
    }
    let metadata = match source.next(path)? {
        Frame::Record { kind: op::METADATA, content, .. } => metadata(content),
        Frame::Record { kind, .. } => {
            Err(Trouble::Damage(not_ours(&format!("a record of kind {kind:#04x}"))))
        }
        Frame::End(Tail::Unsealed | Tail::Cut { .. }) => return Err(Refusal::Cut),
        Frame::End(_) => Err(Trouble::Damage(not_ours("damage"))),
    };
    match metadata {
        Ok(metadata) => Ok((source, metadata)),
        Err(Trouble::Damage(message)) => Err(Refusal::Damage(read_error(path, message))),
        Err(Trouble::Foreign(message)) => Err(Refusal::Foreign(read_error(path, message))),
    }
}

fn metadata(content: &[u8]) -> Result<Metadata, Trouble> {
    let refused = |found: &str| Err(Trouble::Damage(not_ours(found)));
    if content.len() > LONGEST_DECLARATION {
        return refused(&format!("one of {} bytes", content.len()));
    }
    let record = match record::parse(op::METADATA, content) {
        Ok(Record::Metadata(record)) => record,
        Ok(_) => return refused("another record"),
        Err(cause) => return refused(&format!("damage: {cause}")),
    };
    // A record with a wrong length would take a part of the first chunk along.
    let texts = record.metadata.iter().map(|(name, value)| 8 + name.len() + value.len());
    let length = 8 + record.name.len() + texts.sum::<usize>();
    if length != content.len() {
        let found = content.len();
        return refused(&format!("damage: {length} bytes of metadata in a record of {found}"));
    }
    Metadata::check(&record.name, record.metadata)
}

/// Returns where the first chunk begins, whatever comes before it; `None` if there is none where ours have it.
pub(super) fn end(path: &Path) -> Option<u64> {
    let mut bytes = Vec::new();
    File::open(path).ok()?.take(LONGEST).read_to_end(&mut bytes).ok()?;
    let found = (0..bytes.len()).find(|&at| begins_chunk(&bytes[at..]));
    found.map(|at| at as u64)
}

/// Returns whether these bytes begin with the header of a chunk, whose two lengths fit each other.
fn begins_chunk(bytes: &[u8]) -> bool {
    let name_at = RECORD_HEADER + COMPRESSION_AT;
    let length_at = name_at + COMPRESSION.len();
    let Some(header) = bytes.get(..length_at + 8) else { return false };
    if header[0] != op::CHUNK || header[name_at..length_at] != *COMPRESSION {
        return false;
    }
    let number = |at: usize| {
        u64::from_le_bytes(header[at..at + 8].try_into().expect("eight bytes are a number"))
    };
    let before_data = header.len() - RECORD_HEADER;
    number(1).checked_sub(number(length_at)) == Some(before_data as u64)
}
