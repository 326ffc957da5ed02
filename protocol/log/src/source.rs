//! The top-level records of a file, one after another, from its beginning or from a given record.

use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use mcap::McapError;
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use protocol::{Error, durable};

use super::chunk::RECORD_HEADER;
use super::read_error;
use super::record::LONGEST_RECORD;

/// Damage in a file: where it is, and what is wrong.
#[derive(Clone, Debug)]
pub(super) struct Damage {
    pub(super) offset: u64,
    pub(super) reason: String,
}

/// How the bytes of a file end.
#[derive(Clone, Debug)]
pub(super) enum Tail {
    /// As a sealed file does.
    Sealed,
    /// After a whole record, without the end of a sealed file.
    Unsealed,
    /// Within the record that starts at `offset`.
    Cut { offset: u64, bytes: u64 },
    /// In bytes from which the next record cannot be found.
    Lost(Damage),
    /// At the checksum of all data, which is wrong. If each chunk is right, something between them is not.
    Altered(Damage),
}

/// The top-level records of a file.
pub(super) struct Source {
    file: BufReader<File>,
    identity: (u64, u64),
    records: LinearReader,
    kind: u8,
    content: Vec<u8>,
    /// Where the last record returned starts, and where it ends.
    start: u64,
    end: u64,
    length: u64,
    read: u64,
}

/// The next part of a file.
pub(super) enum Frame<'a> {
    /// A record, and where it begins.
    Record { kind: u8, content: &'a [u8], offset: u64 },
    /// The end of the file.
    End(Tail),
}

impl Source {
    /// Opens a file at its beginning.
    pub(super) fn open(path: &Path) -> Result<Self, Error> {
        let failed = |cause| read_error(path, format!("cannot open: {cause}"));
        let mut file = File::open(path).map_err(failed)?;
        let mut magic = Vec::new();
        let magic_bytes = mcap::MAGIC.len() as u64;
        file.by_ref().take(magic_bytes).read_to_end(&mut magic).map_err(failed)?;
        if !mcap::MAGIC.starts_with(&magic) {
            let found = magic.escape_ascii();
            let message = format!("expected an MCAP file, found one that begins with `{found}`");
            return Err(read_error(path, message));
        }
        file.rewind().map_err(failed)?;
        let options = options().with_validate_data_section_crc(true);
        let source = Source::new(file, options, 0).map_err(failed)?;
        Ok(Source { end: magic_bytes, ..source })
    }

    /// Opens a file at the record that begins at `offset`.
    pub(super) fn open_at(path: &Path, offset: u64) -> Result<Self, Error> {
        let failed = |cause| read_error(path, format!("cannot open: {cause}"));
        let mut file = File::open(path).map_err(failed)?;
        file.seek(SeekFrom::Start(offset)).map_err(failed)?;
        Source::new(file, options().with_skip_start_magic(true), offset).map_err(failed)
    }

    fn new(file: File, options: LinearReaderOptions, offset: u64) -> io::Result<Self> {
        let found = file.metadata()?;
        let length = found.len().max(offset);
        let records = LinearReader::new_with_options(options);
        let file = BufReader::with_capacity(64 << 10, file);
        let (kind, content) = (0, Vec::new());
        Ok(Source {
            file,
            identity: durable::identity(&found),
            records,
            kind,
            content,
            start: offset,
            end: offset,
            length,
            read: offset,
        })
    }

    /// Returns the open file.
    pub(super) fn file(&self) -> &File {
        self.file.get_ref()
    }

    /// Returns the file's device and inode number, which no other file has while this one is open.
    pub(super) fn identity(&self) -> (u64, u64) {
        self.identity
    }

    /// Returns the length of the file when it was opened.
    pub(super) fn length(&self) -> u64 {
        self.length
    }

    /// Returns where the last whole record ends.
    pub(super) fn end(&self) -> u64 {
        self.end
    }

    /// Returns the next record, or how the file ends.
    pub(super) fn next(&mut self, path: &Path) -> Result<Frame<'_>, Error> {
        loop {
            match self.records.next_event() {
                Some(Ok(LinearReadEvent::ReadRequest(wanted))) => self.fill(wanted, path)?,
                Some(Ok(LinearReadEvent::Record { opcode, data })) => {
                    (self.kind, self.start) = (opcode, self.end);
                    self.end += (RECORD_HEADER + data.len()) as u64;
                    self.content.clear();
                    self.content.extend_from_slice(data);
                    break;
                }
                Some(Err(cause)) => return Ok(Frame::End(self.tail(cause))),
                None => return Ok(Frame::End(Tail::Sealed)),
            }
        }
        Ok(Frame::Record { kind: self.kind, content: &self.content, offset: self.start })
    }

    /// Reads what the parser asks for, up to the length that the file had when it was opened.
    fn fill(&mut self, wanted: usize, path: &Path) -> Result<(), Error> {
        let left = usize::try_from(self.length - self.read).unwrap_or(usize::MAX);
        let room = self.records.insert(wanted.min(left));
        let count = loop {
            match self.file.read(room) {
                Err(cause) if cause.kind() == std::io::ErrorKind::Interrupted => {}
                read => break read,
            }
        };
        let count = count.map_err(|cause| {
            read_error(path, format!("cannot read at byte {}: {cause}", self.read))
        })?;
        self.records.notify_read(count);
        self.read += count as u64;
        Ok(())
    }

    fn tail(&self, cause: McapError) -> Tail {
        match cause {
            McapError::UnexpectedEof if self.read <= self.end => Tail::Unsealed,
            McapError::UnexpectedEof => Tail::Cut { offset: self.end, bytes: self.read - self.end },
            cause => {
                let damage = Damage { offset: self.end, reason: cause.to_string() };
                match cause {
                    McapError::BadDataCrc { .. } => Tail::Altered(damage),
                    _ => Tail::Lost(damage),
                }
            }
        }
    }
}

fn options() -> LinearReaderOptions {
    LinearReaderOptions::default()
        .with_emit_chunks(true)
        .with_validate_summary_section_crc(true)
        .with_check_finishes_after_end_magic(true)
        .with_record_length_limit(LONGEST_RECORD)
}
