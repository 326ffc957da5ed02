//! [`FileWriter`]: one MCAP file from its creation to its sealing.
//!
//! One failed write makes mcap's own writer unusable and loses the open chunk. So here it writes to memory, where
//! nothing fails, and each finished chunk is copied from there to the file. What the disk does not accept stays in
//! memory until it does.

use std::collections::BTreeMap;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard};

use mcap::records::MessageHeader;
use mcap::write::NoSeek;
use mcap::{Compression, McapError, WriteOptions};
use protocol::trajectory::Encoded;
use protocol::{Error, durable};

use super::folder::{ACTIVE, sync_folder_of, with_ending};
use super::metadata::{Kind, Metadata};
use super::reader::FileReader;
use super::record::LONGEST_RECORD;
use super::topic::Topic;
use super::write_error;

/// Uncompressed bytes after which a chunk is closed. A crash can lose about as much.
const CHUNK_BYTES: u64 = 1 << 20;
/// Maximum length of a message, in bytes, so that readers can bound their memory.
pub const LONGEST_MESSAGE: usize = LONGEST_RECORD / 2;

/// Writes one file: a run's through [`LogWriter`](super::LogWriter), demonstrations directly.
///
/// **Errors.** [`Error::LogWrite`] means that the disk did not accept a finished chunk. Nothing is lost: what was
/// handed over is in memory. The owner stops writing, calls [`flush`](Self::flush) until it succeeds, and continues;
/// nothing is then missing or duplicated in the file. [`Error::LogRefused`] means that a message is not in the file
/// and will not be. [`Error::LogUnsynced`] means that what was written may be lost. Every later sync returns it as
/// well.
///
/// **Names.** The file is called `PATH.active` until [`seal`](Self::seal). A writer that is dropped unsealed flushes
/// and leaves `PATH.active`, which can be read and which [`repair`](super::repair()) seals. The file is locked while
/// its writer lives.
pub struct FileWriter {
    path: PathBuf,
    active: PathBuf,
    storage: Box<dyn Storage>,
    memory: Memory,
    writer: mcap::Writer<NoSeek<Memory>>,
    channels: BTreeMap<Topic, Channel>,
    bytes: u64,
    /// The error of the sync that failed, if one has.
    unsynced: Option<Error>,
    state: State,
}

struct Channel {
    id: u16,
    messages: u32,
}

#[derive(PartialEq)]
enum State {
    Open,
    /// Takes no more messages; its end may not be on the disk yet.
    Ended,
    Sealed,
}

impl FileWriter {
    /// Creates `path` (`path.active` until it is sealed) for messages of `topics`, with `metadata`
    /// as its first record. Never overwrites a file.
    ///
    /// # Errors
    /// [`Error::LogWrite`] if the file exists or cannot be created.
    pub fn create(path: &Path, metadata: &Metadata, topics: &[Topic]) -> Result<Self, Error> {
        if path.exists() {
            let exists = io::Error::from(io::ErrorKind::AlreadyExists);
            return Err(write_error(path, "create the file", &exists));
        }
        Self::open(path, metadata, topics)
    }

    /// As [`create`](Self::create), but replaces an existing file, which stays until this one is sealed. What a dead
    /// writer of the same kind left is removed.
    ///
    /// # Errors
    /// [`Error::LogWrite`] if somebody is writing such a file, or it cannot be created; [`Error::LogRead`] if an
    /// abandoned one cannot be read.
    pub fn create_anew(path: &Path, metadata: &Metadata, topics: &[Topic]) -> Result<Self, Error> {
        remove_abandoned(path, metadata.kind)?;
        Self::open(path, metadata, topics)
    }

    fn open(path: &Path, metadata: &Metadata, topics: &[Topic]) -> Result<Self, Error> {
        let active = with_ending(path, ACTIVE);
        let file = OpenOptions::new().write(true).create_new(true).open(&active);
        let file = file.map_err(|cause| write_error(&active, "create the file", &cause))?;
        // The lock keeps others from sealing the file. Those who test it hold it for a moment, so this waits. If files
        // cannot be locked, the run's own lock must do.
        file.lock().ok();
        let mut writer = Self::begin(path, Box::new(file), metadata, topics)
            .map_err(|cause| failed(&active, cause))?;
        if let Err(error) = writer.drain().and_then(|()| sync_folder_of(&active)) {
            // The caller gets no writer to try again with, so the number must be free for the next attempt.
            writer.state = State::Sealed;
            fs::remove_file(&writer.active).ok();
            return Err(error);
        }
        Ok(writer)
    }

    /// Lays out header and metadata in memory. Schemas and channels get a chunk with the first message alone: damage
    /// to a chunk of many messages must not take them along, and a chunk without messages would make the index say
    /// that the file begins in 1970.
    fn begin(
        path: &Path,
        storage: Box<dyn Storage>,
        metadata: &Metadata,
        topics: &[Topic],
    ) -> Result<Self, McapError> {
        let memory = Memory::default();
        let mut writer = WriteOptions::new()
            .compression(Some(Compression::Zstd))
            .compression_level(1)
            .compression_threads(0)
            .chunk_size(Some(CHUNK_BYTES))
            .disable_seeking(true)
            .library(concat!("goalward/", env!("CARGO_PKG_VERSION")))
            .create(NoSeek::new(memory.clone()))?;
        let name = metadata.kind.name().to_owned();
        let metadata = metadata.entries.clone();
        writer.write_metadata(&mcap::records::Metadata { name, metadata })?;
        let mut channels = BTreeMap::new();
        for &topic in topics {
            let schema = writer.add_schema(topic.schema(), "protobuf", topic.schema_set())?;
            let id = writer.add_channel(schema, topic.name(), "protobuf", &BTreeMap::new())?;
            channels.insert(topic, Channel { id, messages: 0 });
        }
        let (path, active) = (path.to_owned(), with_ending(path, ACTIVE));
        Ok(FileWriter {
            path,
            active,
            storage,
            memory,
            writer,
            channels,
            bytes: 0,
            unsynced: None,
            state: State::Open,
        })
    }

    /// Appends a trajectory's encoded bytes as they are.
    ///
    /// # Errors
    /// As [`FileWriter::message`].
    pub fn trajectory(&mut self, trajectory: &Encoded, log_time_ns: u64) -> Result<(), Error> {
        self.message(Topic::of(&trajectory.trajectory), log_time_ns, &trajectory.bytes)
    }

    /// Appends an encoded message. Its log time must not be before that of the previous message.
    ///
    /// # Errors
    /// [`Error::LogWrite`] for a full or failing disk. [`Error::LogRefused`] for a message longer than
    /// [`LONGEST_MESSAGE`], of a topic that the file was not created for, or after the end of the
    /// file.
    pub fn message(&mut self, topic: Topic, log_time_ns: u64, bytes: &[u8]) -> Result<(), Error> {
        self.check(topic, bytes)?;
        let is_first = self.channels.values().all(|channel| channel.messages == 0);
        let channel = self.channels.get_mut(&topic).expect("checked above");
        let header = MessageHeader {
            channel_id: channel.id,
            sequence: channel.messages,
            log_time: log_time_ns,
            publish_time: log_time_ns,
        };
        channel.messages += 1;
        let written = self.writer.write_to_known_channel(&header, bytes);
        written.map_err(|cause| failed(&self.active, cause))?;
        if is_first { self.flush() } else { self.drain() }
    }

    fn check(&self, topic: Topic, bytes: &[u8]) -> Result<(), Error> {
        let name = topic.name();
        let message = if self.state != State::Open {
            format!("cannot append a message of {name}: the file has been ended")
        } else if !self.channels.contains_key(&topic) {
            format!("cannot append a message of {name}: the file was not created for it")
        } else if bytes.len() > LONGEST_MESSAGE {
            let length = bytes.len();
            format!("{name}: expected messages up to {LONGEST_MESSAGE} bytes, found {length}")
        } else {
            return Ok(());
        };
        Err(Error::LogRefused { path: self.active.clone(), message })
    }

    /// Closes the open chunk and hands everything to the operating system: what was appended so far survives the death
    /// of this process.
    ///
    /// # Errors
    /// [`Error::LogWrite`] for a full or failing disk.
    pub fn flush(&mut self) -> Result<(), Error> {
        if self.state == State::Open {
            self.writer.flush().map_err(|cause| failed(&self.active, cause))?;
        }
        self.drain()
    }

    /// Flushes, and waits until everything is on the disk: what was appended so far survives the death of the machine.
    ///
    /// # Errors
    /// [`Error::LogWrite`] for a full or failing disk, [`Error::LogUnsynced`] once it has failed to sync.
    pub fn sync(&mut self) -> Result<(), Error> {
        self.flush()?;
        if self.unsynced.is_none() {
            let failed = self.storage.sync().err();
            self.unsynced = failed.map(|cause| unsynced(&self.active, &cause));
        }
        self.unsynced.clone().map_or(Ok(()), Err)
    }

    /// Ends the file with its index, syncs it and gives it its final name. Can be called again after an error.
    ///
    /// # Errors
    /// As [`FileWriter::sync`].
    pub fn seal(&mut self) -> Result<(), Error> {
        if self.state == State::Sealed {
            return Ok(());
        }
        self.writer.finish().map_err(|cause| failed(&self.active, cause))?;
        self.state = State::Ended;
        self.sync()?;
        fs::rename(&self.active, &self.path).map_err(|cause| {
            write_error(&self.active, &format!("rename to {}", self.path.display()), &cause)
        })?;
        self.state = State::Sealed;
        sync_folder_of(&self.path)
    }

    /// Discards the file: nothing of it stays on the disk. A sealed file stays.
    ///
    /// # Errors
    /// [`Error::LogWrite`] if the file cannot be removed.
    pub fn discard(&mut self) -> Result<(), Error> {
        if self.state == State::Sealed {
            return Ok(());
        }
        self.state = State::Sealed;
        fs::remove_file(&self.active).map_err(|cause| write_error(&self.active, "remove", &cause))
    }

    /// Returns whether it still accepts messages.
    pub(super) fn is_open(&self) -> bool {
        self.state == State::Open
    }

    /// Returns the number of bytes that the operating system has accepted.
    pub fn bytes_written(&self) -> u64 {
        self.bytes
    }

    /// Copies finished chunks from memory to the file.
    fn drain(&mut self) -> Result<(), Error> {
        let mut memory = self.memory.lock();
        let mut taken = 0;
        let mut result = Ok(());
        while taken < memory.len() && result.is_ok() {
            match self.storage.write(&memory[taken..]) {
                Ok(0) => result = Err(io::ErrorKind::WriteZero.into()),
                Ok(count) => taken += count,
                Err(cause) if cause.kind() == io::ErrorKind::Interrupted => {}
                Err(cause) => result = Err(cause),
            }
        }
        self.bytes += taken as u64;
        memory.drain(..taken);
        result.map_err(|cause| {
            let attempt = format!("write {} bytes at byte {}", memory.len(), self.bytes);
            write_error(&self.active, &attempt, &cause)
        })
    }
}

impl Drop for FileWriter {
    fn drop(&mut self) {
        if self.state != State::Sealed
            && let Err(error) = self.flush()
        {
            tracing::error!("messages are lost: {error}");
        }
    }
}

/// Removes what a dead writer left of the file `path`, if it is of this kind or ends before its metadata.
///
/// # Errors
/// [`Error::LogRead`] or [`Error::LogWrite`] if it cannot be read or removed.
pub fn remove_abandoned(path: &Path, kind: Kind) -> Result<(), Error> {
    let active = &with_ending(path, ACTIVE);
    if !active.exists() || durable::is_locked(active) {
        return Ok(());
    }
    if FileReader::open_begun(active)?.is_some_and(|reader| reader.metadata().kind != kind) {
        return Ok(());
    }
    fs::remove_file(active)
        .map_err(|cause| write_error(active, "remove the abandoned file", &cause))
}

/// Returns the error for a message that mcap cannot lay out: not the disk's fault, and not expected.
fn failed(path: &Path, cause: McapError) -> Error {
    Error::LogRefused { path: path.to_owned(), message: format!("cannot lay out: {cause}") }
}

/// Returns the error of a failed sync. What the system had accepted is not in memory, so nobody can write it again.
fn unsynced(path: &Path, cause: &io::Error) -> Error {
    let message =
        format!("cannot sync: {cause}; what was written cannot be known to be on the disk");
    Error::LogUnsynced { path: path.to_owned(), message }
}

/// What a file is written to.
trait Storage: Write + Send {
    /// Returns when the disk has all that was written.
    fn sync(&mut self) -> io::Result<()>;
}

impl Storage for File {
    fn sync(&mut self) -> io::Result<()> {
        self.sync_all()
    }
}

/// Encoded bytes on their way to the file.
#[derive(Clone, Default)]
struct Memory(Arc<Mutex<Vec<u8>>>);

impl Memory {
    fn lock(&self) -> MutexGuard<'_, Vec<u8>> {
        self.0.lock().expect("nothing panics while it holds the bytes")
    }
}

impl Write for Memory {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.lock().extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Ending, Record};

    /// A disk with limited room: the number of free bytes, and what was written.
    #[derive(Clone, Default)]
    struct Disk(Arc<Mutex<(usize, Vec<u8>)>>);

    impl Write for Disk {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            let mut disk = self.0.lock().unwrap();
            let count = bytes.len().min(disk.0);
            disk.0 -= count;
            disk.1.extend_from_slice(&bytes[..count]);
            if count == 0 { Err(io::ErrorKind::StorageFull.into()) } else { Ok(count) }
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    impl Storage for Disk {
        fn sync(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    /// A disk that loses what it has accepted, and reports that once.
    #[derive(Default)]
    struct LosingDisk {
        has_told: bool,
    }

    impl Write for LosingDisk {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    impl Storage for LosingDisk {
        fn sync(&mut self) -> io::Result<()> {
            match std::mem::replace(&mut self.has_told, true) {
                true => Ok(()),
                false => Err(io::Error::other("a bad sector")),
            }
        }
    }

    #[test]
    fn a_sync_that_failed_is_not_made_good_by_the_next() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file.mcap");
        let metadata = Metadata::new(Kind::Run, "navigation", 1);
        let storage = Box::new(LosingDisk::default());
        let mut writer =
            FileWriter::begin(&path, storage, &metadata, &[Topic::Trajectory]).unwrap();
        fs::write(&writer.active, b"").unwrap();
        writer.message(Topic::Trajectory, 1, &noise(1)).unwrap();
        for _ in 0..2 {
            for failed in [writer.sync(), writer.seal()] {
                let error = failed.unwrap_err();
                assert!(matches!(error, Error::LogUnsynced { .. }), "{error:?}");
                let error = error.to_string();
                assert!(error.contains("file.mcap.active: cannot sync: a bad sector"), "{error}");
            }
        }
        assert!(writer.active.exists() && !path.exists(), "it is left for a repair");
    }

    /// Returns bytes that no compressor makes smaller.
    fn noise(number: u64) -> Vec<u8> {
        let hashes = (0..2000u64)
            .map(|place| xxhash_rust::xxh3::xxh3_64_with_seed(b"", place))
            .map(|hash| hash.wrapping_mul(2 * number + 1));
        hashes.flat_map(u64::to_le_bytes).collect()
    }

    #[test]
    fn a_full_disk_loses_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file.mcap");
        let disk = Disk::default();
        disk.0.lock().unwrap().0 = 3 << 20;
        let metadata = Metadata::new(Kind::Run, "navigation", 1);
        let storage = Box::new(disk.clone());
        let mut writer =
            FileWriter::begin(&path, storage, &metadata, &[Topic::Trajectory]).unwrap();
        let mut written = 0;
        let error = loop {
            written += 1;
            if let Err(error) = writer.message(Topic::Trajectory, written, &noise(written)) {
                assert!(matches!(error, Error::LogWrite { .. }), "{error:?}");
                break error.to_string();
            }
            assert!(written < 1000, "the disk took more than it has room for");
        };
        assert!(
            error.contains("file.mcap.active") && error.contains("no room on the disk"),
            "{error}"
        );
        for _ in 0..3 {
            assert!(writer.flush().is_err() && writer.sync().is_err() && writer.seal().is_err());
        }
        let error = writer.message(Topic::Trajectory, 0, b"").unwrap_err();
        assert!(matches!(error, Error::LogRefused { .. }), "{error:?}");
        assert!(error.to_string().contains("has been ended"), "{error}");
        disk.0.lock().unwrap().0 = usize::MAX;
        fs::write(&writer.active, b"").unwrap();
        writer.seal().unwrap();
        assert_eq!(writer.bytes_written(), disk.0.lock().unwrap().1.len() as u64);
        fs::write(&path, &disk.0.lock().unwrap().1).unwrap();

        let mut reader = FileReader::open(&path).unwrap();
        for number in 1..=written {
            let record = reader.next().unwrap().unwrap().record;
            assert!(record == Record::Trajectory(noise(number).into()), "message {number}");
        }
        assert!(reader.next().is_none());
        assert_eq!(reader.ending(), Some(&Ending::Complete));
    }
}
