//! [`FileReader`]: the records of one file, and how the file ends.
//!
//! Reads sealed files, files that are being written, and files that a crash or a bad disk left. The records returned
//! are always those that were written, in order and without a gap: reading stops at the first damage and reports it,
//! unless the damage is before all records.
//! [`repair`](super::repair()) continues after the damage.

use std::collections::VecDeque;
use std::fmt;
use std::path::{Path, PathBuf};

use bytes::Bytes;
use prost::DecodeError;
use prost::Message as _;
use protocol::Error;
use protocol::messages::{Checkpoint, PolicyUpdate, RewardUpdate, Score};
use protocol::scene::{CompressedImage, SceneUpdate};

use super::folder::{followed, is_active};
use super::metadata::Metadata;
use super::read_error;
use super::scan::{Block, Message, Scanner, Unread};
use super::source::{Damage, Tail};
use super::topic::Topic;

/// A recorded message. Trajectories are encoded, as the actor published them;
/// [`Encoded::decode`](protocol::trajectory::Encoded::decode) decodes and checks them.
#[derive(Clone, Debug, PartialEq)]
pub enum Record {
    /// On `/trajectory`.
    Trajectory(Bytes),
    /// On `/evaluation/trajectory`.
    EvaluationTrajectory(Bytes),
    /// On `/proximity/score`.
    Score(Score),
    /// On `/policy/update`.
    PolicyUpdate(Box<PolicyUpdate>),
    /// On `/proximity/update`.
    RewardUpdate(RewardUpdate),
    /// On `/checkpoint`.
    Checkpoint(Checkpoint),
    /// On `/evaluation/scene`.
    Scene(SceneUpdate),
    /// On `/evaluation/image`.
    Picture(CompressedImage),
}

impl Record {
    /// Returns the encoded trajectory, of training or of evaluation, if the record is one.
    pub fn trajectory(self) -> Option<Bytes> {
        match self {
            Record::Trajectory(bytes) | Record::EvaluationTrajectory(bytes) => Some(bytes),
            _ => None,
        }
    }

    fn decode(topic: Topic, bytes: Bytes) -> Result<Self, DecodeError> {
        Ok(match topic {
            Topic::Trajectory => Record::Trajectory(bytes),
            Topic::EvaluationTrajectory => Record::EvaluationTrajectory(bytes),
            Topic::Score => Record::Score(Score::decode(bytes)?),
            Topic::PolicyUpdate => Record::PolicyUpdate(Box::new(PolicyUpdate::decode(bytes)?)),
            Topic::RewardUpdate => Record::RewardUpdate(RewardUpdate::decode(bytes)?),
            Topic::Checkpoint => Record::Checkpoint(Checkpoint::decode(bytes)?),
            Topic::Scene => Record::Scene(SceneUpdate::decode(bytes)?),
            Topic::Picture => Record::Picture(CompressedImage::decode(bytes)?),
        })
    }
}

/// A record and when it was appended.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// Log time, in nanoseconds since 1970.
    pub log_time_ns: u64,
    /// The record.
    pub record: Record,
}

/// How a file ends, or where reading it stopped.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Ending {
    /// Sealed, and every checksum is right.
    Complete,
    /// Not sealed, as its name says: being written, or its writer died. What the writer had not
    /// flushed is missing.
    Unsealed,
    /// Its end is missing.
    Truncated {
        /// Where the first incomplete record starts.
        offset: u64,
        /// Bytes of that record that are there but of no use.
        lost_bytes: u64,
    },
    /// Damaged.
    Corrupt {
        /// Where the damaged record starts.
        offset: u64,
        /// What is wrong with it.
        reason: String,
        /// Bytes that were not read: those from there to the end of the file, or those of a damaged beginning.
        lost_bytes: u64,
        /// Number of records not returned, if the file's summary says how many it has.
        lost_records: Option<u64>,
    },
}

impl Ending {
    /// Returns whether something that was in the file cannot be read.
    pub fn lost(&self) -> bool {
        matches!(self, Ending::Truncated { .. } | Ending::Corrupt { .. })
    }
}

impl fmt::Display for Ending {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Ending::Complete => write!(formatter, "complete"),
            Ending::Unsealed => write!(formatter, "not sealed, undamaged"),
            Ending::Truncated { offset, lost_bytes: 0 } => {
                write!(formatter, "cut off at byte {offset}: its end is missing")
            }
            Ending::Truncated { offset, lost_bytes } => {
                write!(formatter, "cut off: the last {lost_bytes} bytes, from byte {offset}, ")?;
                write!(formatter, "are part of a record")
            }
            Ending::Corrupt { offset, reason, lost_bytes, lost_records } => {
                write!(formatter, "damaged at byte {offset}: {reason}; {lost_bytes} bytes")?;
                match lost_records {
                    Some(count) => write!(formatter, " with {count} records not read"),
                    None => write!(formatter, " not read"),
                }
            }
        }
    }
}

/// Iterates over the records of a file.
///
/// An item is an error if the system cannot read on, if a topic of ours has another schema, or if an intact record is
/// not the message its topic says. Nothing comes after an error. Damage is no error: iteration ends, and
/// [`ending`](Self::ending) reports it.
pub struct FileReader {
    path: PathBuf,
    scanner: Scanner,
    messages: VecDeque<Message>,
    given: u64,
    ending: Option<Ending>,
    failed: bool,
}

impl FileReader {
    /// Opens a file recorded by goalward and reads its metadata. A file in a run's log whose beginning is damaged is
    /// read behind it, with the metadata that the run's other files agree on.
    ///
    /// # Errors
    /// [`Error::LogRead`] if the file is not an MCAP file, is not ours, has a newer format, or ends before its
    /// metadata. A damaged beginning can only be told from these if the file is in the log of a run.
    pub fn open(path: &Path) -> Result<Self, Error> {
        Self::open_begun(path)?.ok_or_else(|| {
            read_error(path, "expected metadata as the first record, found the end of the file")
        })
    }

    /// As [`open`](Self::open), but returns `None` for a file that ends before its metadata.
    pub(super) fn open_begun(path: &Path) -> Result<Option<Self>, Error> {
        Ok(Scanner::open(path)?.map(|scanner| FileReader {
            path: path.to_owned(),
            scanner,
            messages: VecDeque::new(),
            given: 0,
            ending: None,
            failed: false,
        }))
    }

    /// Returns the file's metadata.
    pub fn metadata(&self) -> &Metadata {
        self.scanner.metadata()
    }

    /// Returns how the file ends; `None` until iteration has ended.
    pub fn ending(&self) -> Option<&Ending> {
        self.ending.as_ref()
    }

    /// Returns the byte at which the chunk of the last returned record begins; see [`entries_at`](Self::entries_at).
    pub fn offset(&self) -> u64 {
        self.scanner.offset()
    }

    /// Returns the records of the chunk that begins at byte `offset`, wherever the iteration is.
    ///
    /// # Errors
    /// [`Error::LogRead`] if no chunk of this file begins there, or it is damaged.
    pub fn entries_at(&self, offset: u64) -> Result<Vec<Entry>, Error> {
        let messages = self.scanner.chunk_at(offset)?.into_iter();
        messages.map(|message| decode(&self.path, message)).collect()
    }

    /// Continues the iteration of a file that was being written when the iteration ended. Its writer may have sealed
    /// it since. Returns false if another file has its place, as after a repair: its records have other offsets, so it
    /// must be opened to be read.
    ///
    /// # Errors
    /// [`Error::LogRead`] if the file is gone.
    pub fn go_on(&mut self) -> Result<bool, Error> {
        if self.ending != Some(Ending::Unsealed) {
            return Ok(!self.scanner.is_replaced());
        }
        let is_same = self.scanner.go_on()?;
        if is_same {
            self.path = followed(std::mem::take(&mut self.path));
            self.ending = None;
        }
        Ok(is_same)
    }

    /// Returns whether the metadata may be other than what was written, once iteration has ended.
    pub(super) fn doubts_metadata(&self) -> bool {
        self.scanner.doubts_metadata()
    }

    /// Returns the topics that the file has declared so far.
    pub(super) fn topics(&self) -> Vec<Topic> {
        self.scanner.topics()
    }

    /// Returns the next message, undecoded; `None` at the end.
    pub(super) fn next_message(&mut self) -> Result<Option<Message>, Error> {
        while self.messages.is_empty() && self.ending.is_none() {
            match self.scanner.next_block()? {
                Some(Block::Messages(messages)) => self.messages = messages.into(),
                Some(Block::Damage(damage)) => self.ending = Some(self.corrupt_from(damage)),
                None => self.ending = Some(self.tail()),
            }
        }
        self.given += u64::from(!self.messages.is_empty());
        Ok(self.messages.pop_front())
    }

    fn tail(&self) -> Ending {
        let ending = match self.scanner.tail().cloned() {
            Some(Tail::Sealed) => Ending::Complete,
            None | Some(Tail::Unsealed | Tail::Cut { .. }) if self.scanner.is_being_written() => {
                Ending::Unsealed
            }
            None | Some(Tail::Unsealed) => cut_off(&self.path, self.scanner.length(), 0),
            Some(Tail::Cut { offset, bytes }) => Ending::Truncated { offset, lost_bytes: bytes },
            Some(Tail::Lost(damage) | Tail::Altered(damage)) => self.corrupt_from(damage),
        };
        match self.scanner.unread() {
            Some(Unread { damage, bytes }) if !ending.lost() => {
                self.corrupt(damage.clone(), *bytes)
            }
            _ => ending,
        }
    }

    fn corrupt_from(&self, damage: Damage) -> Ending {
        let lost_bytes = self.scanner.length().saturating_sub(damage.offset);
        self.corrupt(damage, lost_bytes)
    }

    fn corrupt(&self, Damage { offset, reason }: Damage, lost_bytes: u64) -> Ending {
        let lost_records = self.scanner.recorded_messages();
        let lost_records = lost_records.map(|all| all.saturating_sub(self.given));
        Ending::Corrupt { offset, reason, lost_bytes, lost_records }
    }

    fn next_entry(&mut self) -> Result<Option<Entry>, Error> {
        let Some(message) = self.next_message()? else { return Ok(None) };
        decode(&self.path, message).map(Some)
    }
}

impl Iterator for FileReader {
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

/// Returns the ending of a file whose last `bytes` are of no use or, if there are none, whose end is missing. Nothing
/// is lost if the file's name says that it was not sealed.
pub(super) fn cut_off(path: &Path, length: u64, bytes: u64) -> Ending {
    if is_active(path) {
        return Ending::Unsealed;
    }
    Ending::Truncated { offset: length - bytes, lost_bytes: bytes }
}

/// Decodes a message of a file.
pub(super) fn decode(path: &Path, message: Message) -> Result<Entry, Error> {
    let Message { topic, log_time_ns, bytes } = message;
    let record = Record::decode(topic, bytes).map_err(|cause| {
        read_error(path, format!("topic {}: undecodable {}: {cause}", topic.name(), topic.schema()))
    })?;
    Ok(Entry { log_time_ns, record })
}
