//! [`LogWriter`]: the log folder of a run, written by its learner.
//!
//! Two files are open at a time: one for trajectories with their scores, one for updates with checkpoints. When a file
//! has grown enough, the next number is opened and the old file sealed. Each time a run is started or resumed, it
//! opens new numbers; no file is ever appended to again.

use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use prost::Message;
use protocol::messages::{Checkpoint, PolicyUpdate, RewardUpdate, Score};
use protocol::trajectory::Encoded;
use protocol::{Error, durable};

use super::file::FileWriter;
use super::folder::{log_files, next_number, path};
use super::info::info;
use super::metadata::Metadata;
use super::summary::statistics;
use super::topic::{Contents, Topic};
use super::write_error;

/// Options for writing a log.
#[derive(Clone, Copy, Debug)]
pub struct LogOptions {
    /// Size at which a file is sealed and the next one opened.
    pub rotate_bytes: u64,
    /// Whether trajectories keep their observations.
    pub observations: bool,
}

impl Default for LogOptions {
    fn default() -> Self {
        LogOptions { rotate_bytes: 512 << 20, observations: true }
    }
}

/// Writes a run's log. When a call has returned, the message is in the open chunk. The owner calls
/// [`flush`](Self::flush) about every second and [`sync`](Self::sync) at checkpoints.
///
/// An [`Error::LogRefused`] means that a message is not recorded and will not be. An [`Error::LogWrite`] of any call
/// means that the disk refuses, not that the message is lost: pause, call [`flush`](Self::flush) until it succeeds,
/// and continue, without appending the message again. An [`Error::LogUnsynced`] means that what was appended since the
/// last sync may be lost, and no pause helps.
pub struct LogWriter {
    trajectories: Stream,
    updates: Stream,
    observations: bool,
    clock: Clock,
}

impl LogWriter {
    /// Opens the next file of each contents in `folder`, which is created if it is missing. Log times continue after
    /// those of the existing files.
    ///
    /// # Errors
    /// [`Error::LogWrite`] for a full or failing disk, [`Error::LogRead`] if the folder cannot be listed.
    pub fn create(folder: &Path, metadata: &Metadata, options: LogOptions) -> Result<Self, Error> {
        durable::create_folder(folder)
            .map_err(|cause| write_error(folder, "make the folder", &cause))?;
        let clock = Clock { last_ns: newest_log_time_ns(folder)? };
        let stream = |contents| Stream::open(folder, contents, metadata, options);
        Ok(LogWriter {
            trajectories: stream(Contents::Trajectories)?,
            updates: stream(Contents::Updates)?,
            observations: options.observations,
            clock,
        })
    }

    /// Appends a trajectory: its encoded bytes as they are, or without observations.
    ///
    /// # Errors
    /// [`Error::LogWrite`] for a full or failing disk, [`Error::LogRefused`] for a message that is too long.
    pub fn trajectory(&mut self, encoded: &Encoded) -> Result<(), Error> {
        let topic = Topic::of(&encoded.trajectory);
        let now_ns = self.clock.now_ns();
        if self.observations {
            return self.trajectories.message(topic, now_ns, &encoded.bytes);
        }
        let actions_only = encoded.trajectory.clone().actions_only(encoded.key.hash);
        self.trajectories.message(topic, now_ns, &actions_only.encode_to_vec())
    }

    /// Appends a score.
    ///
    /// # Errors
    /// As [`LogWriter::trajectory`].
    pub fn score(&mut self, score: &Score) -> Result<(), Error> {
        self.trajectories.message(Topic::Score, self.clock.now_ns(), &score.encode_to_vec())
    }

    /// Appends a policy update.
    ///
    /// # Errors
    /// As [`LogWriter::trajectory`].
    pub fn policy_update(&mut self, update: &PolicyUpdate) -> Result<(), Error> {
        self.updates.message(Topic::PolicyUpdate, self.clock.now_ns(), &update.encode_to_vec())
    }

    /// Appends an update of the reward model.
    ///
    /// # Errors
    /// As [`LogWriter::trajectory`].
    pub fn reward_update(&mut self, update: &RewardUpdate) -> Result<(), Error> {
        self.updates.message(Topic::RewardUpdate, self.clock.now_ns(), &update.encode_to_vec())
    }

    /// Appends a checkpoint.
    ///
    /// # Errors
    /// As [`LogWriter::trajectory`].
    pub fn checkpoint(&mut self, checkpoint: &Checkpoint) -> Result<(), Error> {
        self.updates.message(Topic::Checkpoint, self.clock.now_ns(), &checkpoint.encode_to_vec())
    }

    /// Closes the open chunks: what was appended so far survives the death of this process.
    ///
    /// # Errors
    /// [`Error::LogWrite`] for a full or failing disk.
    pub fn flush(&mut self) -> Result<(), Error> {
        let trajectories = self.trajectories.flush();
        self.updates.flush()?;
        trajectories
    }

    /// Flushes and waits for the disk: what was appended so far survives the death of the machine.
    ///
    /// # Errors
    /// As [`FileWriter::sync`].
    pub fn sync(&mut self) -> Result<(), Error> {
        self.flush()?;
        self.trajectories.current.sync()?;
        self.updates.current.sync()
    }

    /// Seals all files; can be called again after an error. Nothing can be appended afterwards.
    ///
    /// # Errors
    /// As [`FileWriter::sync`].
    pub fn finish(&mut self) -> Result<(), Error> {
        self.flush()?;
        self.trajectories.current.seal()?;
        self.updates.current.seal()
    }

    /// Returns the number of bytes that the operating system has accepted since [`create`](Self::create).
    pub fn bytes_written(&self) -> u64 {
        self.trajectories.bytes_written() + self.updates.bytes_written()
    }
}

/// The files of one contents, one after another.
struct Stream {
    folder: PathBuf,
    contents: Contents,
    metadata: Metadata,
    rotate_bytes: u64,
    number: u32,
    current: FileWriter,
    /// The previous file, while the disk does not let it be sealed.
    unsealed: Option<FileWriter>,
    earlier_bytes: u64,
}

impl Stream {
    fn open(
        folder: &Path,
        contents: Contents,
        metadata: &Metadata,
        options: LogOptions,
    ) -> Result<Self, Error> {
        let number = next_number(folder, contents)?;
        let current =
            FileWriter::create(&path(folder, contents, number), metadata, contents.topics())?;
        Ok(Stream {
            folder: folder.to_owned(),
            contents,
            metadata: metadata.clone(),
            rotate_bytes: options.rotate_bytes,
            number,
            current,
            unsealed: None,
            earlier_bytes: 0,
        })
    }

    fn message(&mut self, topic: Topic, log_time_ns: u64, bytes: &[u8]) -> Result<(), Error> {
        self.current.message(topic, log_time_ns, bytes)?;
        self.rotate()
    }

    fn flush(&mut self) -> Result<(), Error> {
        self.current.flush()?;
        self.rotate()
    }

    /// Opens the next file when the current one has grown enough, and seals the previous one.
    fn rotate(&mut self) -> Result<(), Error> {
        let grown = self.current.is_open() && self.current.bytes_written() >= self.rotate_bytes;
        if grown && self.unsealed.is_none() {
            let path = path(&self.folder, self.contents, self.number + 1);
            let next = FileWriter::create(&path, &self.metadata, self.contents.topics())?;
            self.number += 1;
            self.unsealed = Some(std::mem::replace(&mut self.current, next));
        }
        if let Some(file) = &mut self.unsealed {
            file.seal()?;
            self.earlier_bytes += file.bytes_written();
            self.unsealed = None;
        }
        Ok(())
    }

    fn bytes_written(&self) -> u64 {
        let unsealed = self.unsealed.as_ref().map_or(0, FileWriter::bytes_written);
        self.earlier_bytes + unsealed + self.current.bytes_written()
    }
}

/// Returns the newest log time in a folder's files, as far as they can be read; 0 if there is none.
fn newest_log_time_ns(folder: &Path) -> Result<u64, Error> {
    let times = log_files(folder)?.into_iter().filter_map(|file| last_log_time_ns(&file.path));
    Ok(times.max().unwrap_or(0))
}

/// Returns the newest log time in a file. A file without statistics is read for it.
fn last_log_time_ns(path: &Path) -> Option<u64> {
    match statistics(path) {
        Some(statistics) => Some(statistics.message_end_time),
        None => info(path).ok()??.span_ns.map(|(_, last)| last),
    }
}

/// The clock of log times: wall time that never goes back, not even when a run is resumed, because log times show what
/// a run that went back has undone. It is the only clock of this crate, and results do not depend on it.
struct Clock {
    last_ns: u64,
}

impl Clock {
    /// Returns the next log time, in nanoseconds since 1970.
    fn now_ns(&mut self) -> u64 {
        let elapsed = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let wall_ns = u64::try_from(elapsed.as_nanos()).unwrap_or(u64::MAX);
        self.last_ns = wall_ns.max(self.last_ns.saturating_add(1));
        self.last_ns
    }
}
