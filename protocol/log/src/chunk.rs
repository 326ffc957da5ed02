//! Unpacks chunks. Only here can a few bytes of a file become many in memory.
//!
//! Sizes and checksums in a file are not trusted until they have been checked. So no file, damaged or malicious, takes
//! more memory than one chunk may have, or more time than its length is worth.

use std::borrow::Cow;

use mcap::records::{self, ChunkHeader, op};
use zstd::bulk::Decompressor;

use super::record::{self, LONGEST_RECORD, Trouble};

/// Bytes before the content of a record: its kind and its length.
pub(super) const RECORD_HEADER: usize = 1 + 8;

/// Maximum number of records in a chunk. Ours have at most 34,000.
const MOST_RECORDS: u64 = 1 << 20;

/// Maximum ratio of unpacked to packed bytes, over the whole file. A chunk of nothing but equal messages grows some
/// thousand times.
const MOST_EXPANSION: u64 = 10_000;

/// Unpacks the chunks of one file.
#[derive(Default)]
pub(super) struct Chunks {
    decompressor: Decompressor<'static>,
    /// Bytes of chunks seen so far, as they are in the file.
    packed: u64,
    /// Bytes and records unpacked from them.
    unpacked: u64,
    records: u64,
}

impl Chunks {
    /// Passes the records of a chunk to `take`, after checking the checksum.
    pub(super) fn open(
        &mut self,
        content: &[u8],
        mut take: impl FnMut(u8, &[u8]) -> Result<(), Trouble>,
    ) -> Result<(), Trouble> {
        let (header, packed) = parse(content)?;
        self.packed += content.len() as u64;
        self.unpacked += header.uncompressed_size;
        if self.unpacked > LONGEST_RECORD as u64 + MOST_EXPANSION * self.packed {
            return Err(Trouble::Foreign(format!(
                "expected chunks that grow to {MOST_EXPANSION} times their length at most, found \
                 {} bytes that become {}",
                self.packed, self.unpacked
            )));
        }
        let records = match header.compression.as_str() {
            "" => packed,
            _ => self.unpack(&packed, header.uncompressed_size as usize)?.into(),
        };
        check(&header, &records)?;
        let mut count = 0;
        each(&records, |kind, content| {
            count += 1;
            self.count(count)?;
            take(kind, content)
        })
    }

    /// Decompresses the `expected` bytes of a chunk, and never more than those.
    fn unpack(&mut self, packed: &[u8], expected: usize) -> Result<Vec<u8>, Trouble> {
        let mut unpacked = Vec::with_capacity(expected);
        match self.decompressor.decompress_to_buffer(packed, &mut unpacked) {
            Ok(_) => Ok(unpacked),
            Err(cause) => Err(damage(format!("undecompressable to {expected} bytes: {cause}"))),
        }
    }

    /// Counts a record; `of_chunk` is its number within its chunk.
    fn count(&mut self, of_chunk: u64) -> Result<(), Trouble> {
        self.records += 1;
        // A message that is listed in a file's index takes more than two bytes of the file.
        if self.records > MOST_RECORDS + self.packed / 2 {
            let (found, bytes) = (self.records, self.packed);
            return Err(Trouble::Foreign(format!(
                "expected {MOST_RECORDS} records and one for every two bytes, found {found} in \
                 {bytes} bytes of chunks"
            )));
        }
        match of_chunk {
            0..=MOST_RECORDS => Ok(()),
            _ => Err(damage(format!("expected up to {MOST_RECORDS} records, found more"))),
        }
    }
}

/// Returns the header and the data of a chunk that can be unpacked.
fn parse(content: &[u8]) -> Result<(ChunkHeader, Cow<'_, [u8]>), Trouble> {
    let record = record::parse(op::CHUNK, content).map_err(damage)?;
    let records::Record::Chunk { header, data } = record else {
        return Err(damage("expected a chunk, found another record".to_owned()));
    };
    match header.compression.as_str() {
        "" | "zstd" => {}
        // A valid name of the format is no damage.
        "lz4" => {
            let message = "expected chunks compressed by zstd, or not at all, found lz4, which is \
                           not supported";
            return Err(Trouble::Foreign(message.to_owned()));
        }
        other => return Err(damage(format!("expected the compression zstd, found {other:?}"))),
    }
    if header.uncompressed_size > LONGEST_RECORD as u64 {
        let found = header.uncompressed_size;
        return Err(damage(format!(
            "expected a chunk of up to {LONGEST_RECORD} bytes, found {found}"
        )));
    }
    Ok((header, data))
}

/// Checks a chunk's records against its header. A checksum of 0 means that there is none.
fn check(header: &ChunkHeader, records: &[u8]) -> Result<(), Trouble> {
    if records.len() as u64 != header.uncompressed_size {
        let (expected, found) = (header.uncompressed_size, records.len());
        return Err(damage(format!("expected a chunk of {expected} bytes, found {found}")));
    }
    let found = crc32fast::hash(records);
    match header.uncompressed_crc {
        0 => Ok(()),
        expected if expected == found => Ok(()),
        expected => {
            Err(damage(format!("expected the chunk's checksum {expected:08x}, found {found:08x}")))
        }
    }
}

/// Passes kind and content of each record of a chunk, or of other bytes, to `take`.
pub(super) fn each(
    mut records: &[u8],
    mut take: impl FnMut(u8, &[u8]) -> Result<(), Trouble>,
) -> Result<(), Trouble> {
    while let Some((header, rest)) = records.split_first_chunk::<RECORD_HEADER>() {
        let [kind, length @ ..] = *header;
        let length = u64::from_le_bytes(length);
        let Some((content, behind)) =
            usize::try_from(length).ok().and_then(|length| rest.split_at_checked(length))
        else {
            let room = rest.len();
            return Err(damage(format!("a record of {length} bytes in {room} bytes of chunk")));
        };
        take(kind, content)?;
        records = behind;
    }
    match records {
        [] => Ok(()),
        rest => Err(damage(format!("{} bytes after the last record of a chunk", rest.len()))),
    }
}

fn damage(reason: String) -> Trouble {
    Trouble::Damage(reason)
}
