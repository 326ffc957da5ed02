//! Turns the bytes of a file into blocks of messages, whatever state the file is in.
//!
//! An MCAP file is a sequence of records: kind, length, content. Messages are in chunks, which are records with a
//! checksum of their own. So damage costs only the damaged chunk: its length still says where the next record is.
//! Memory is bounded by one chunk, whose limits are in `chunk`.

use std::collections::{BTreeMap, VecDeque};
use std::fs::TryLockError;
use std::path::{Path, PathBuf};

use bytes::Bytes;
use mcap::records::{self, MessageHeader, op};
use protocol::{Error, durable};

use super::beginning::{self, Refusal};
use super::chunk::{Chunks, each};
use super::folder::followed;
use super::metadata::Metadata;
use super::read_error;
use super::record::{self, LONGEST_DECLARATION, Trouble};
use super::siblings;
use super::source::{Damage, Frame, Source, Tail};
use super::summary::Summary;
use super::topic::Topic;

/// Number of characters kept of a foreign schema's name, for error messages.
const LETTERS_KEPT: usize = 100;

/// A message as recorded.
#[derive(PartialEq)]
pub(super) struct Message {
    pub(super) topic: Topic,
    pub(super) log_time_ns: u64,
    pub(super) bytes: Bytes,
}

/// The next part of a file.
pub(super) enum Block {
    /// A chunk whose checksum is right. None of its messages is missing.
    Messages(Vec<Message>),
    /// Damage. Scanning can continue after it.
    Damage(Damage),
}

/// A beginning that cannot be read.
pub(super) struct Unread {
    pub(super) damage: Damage,
    /// Bytes of the beginning.
    pub(super) bytes: u64,
}

/// Reads a file block by block.
pub(super) struct Scanner {
    path: PathBuf,
    metadata: Metadata,
    source: Source,
    chunks: Chunks,
    directory: Directory,
    /// Whether the summary has been read for channels that the beginning lacks.
    summary_read: bool,
    /// Blocks that were found and not returned yet.
    held: VecDeque<Block>,
    /// The beginning, if it cannot be read.
    unread: Option<Unread>,
    /// Where the last returned block begins.
    offset: u64,
    tail: Option<Tail>,
}

impl Scanner {
    /// Opens a file and reads its metadata. A file of a run whose beginning is damaged gets the metadata that the other
    /// files of the run agree on. Returns `None` if the file ends before its metadata, as a crash can leave it.
    pub(super) fn open(path: &Path) -> Result<Option<Self>, Error> {
        let (reason, refused) = match beginning::read(path) {
            Ok((source, metadata)) => return Ok(Some(Scanner::new(path, source, metadata))),
            Err(Refusal::Foreign(error)) => return Err(error),
            Err(Refusal::Cut) => ("a record of it is longer than the file".to_owned(), Ok(None)),
            Err(Refusal::Damage(error)) => {
                let reason = match &error {
                    Error::LogRead { message, .. } => message.clone(),
                    error => error.to_string(),
                };
                (reason, Err(error))
            }
        };
        match Scanner::open_behind_beginning(path, &reason) {
            Some(scanner) => Ok(Some(scanner)),
            None => refused,
        }
    }

    /// Opens a file of a run at its first chunk. Returns `None` if nothing shows that the file is one.
    fn open_behind_beginning(path: &Path, reason: &str) -> Option<Self> {
        let bytes = beginning::end(path)?;
        let metadata = siblings::agreed(path)?;
        let mut scanner = Scanner::new(path, Source::open_at(path, bytes).ok()?, metadata);
        // If the chunk that declares the channels is damaged, too, the summary has them.
        scanner.directory.adopt(Repeated::read(path), false);
        if let Some(first) = scanner.next_block().ok()? {
            scanner.held.push_front(first);
        }
        let reason = format!(
            "its beginning cannot be read ({reason}); its metadata is that of the run's other files"
        );
        scanner.unread = Some(Unread { damage: Damage { offset: 0, reason }, bytes });
        (!scanner.topics().is_empty()).then_some(scanner)
    }

    fn new(path: &Path, source: Source, metadata: Metadata) -> Self {
        Scanner {
            path: path.to_owned(),
            metadata,
            source,
            chunks: Chunks::default(),
            directory: Directory::default(),
            summary_read: false,
            held: VecDeque::new(),
            unread: None,
            offset: 0,
            tail: None,
        }
    }

    pub(super) fn metadata(&self) -> &Metadata {
        &self.metadata
    }

    /// Returns the beginning, if it cannot be read.
    pub(super) fn unread(&self) -> Option<&Unread> {
        self.unread.as_ref()
    }

    /// Returns whether the metadata may be other than what was written, once [`next_block`](Self::next_block) has
    /// returned all of the file.
    pub(super) fn doubts_metadata(&self) -> bool {
        self.unread.is_some() || matches!(self.tail, Some(Tail::Altered(_)))
    }

    /// Returns how the file ends, once [`next_block`](Self::next_block) has returned all of it.
    pub(super) fn tail(&self) -> Option<&Tail> {
        self.tail.as_ref()
    }

    /// Returns the number of messages that are missing so far, as sequence numbers show.
    pub(super) fn missing(&self) -> u64 {
        self.directory.missing
    }

    /// Returns the topics that the file has declared so far.
    pub(super) fn topics(&self) -> Vec<Topic> {
        self.directory.channels.values().filter_map(|channel| channel.topic).collect()
    }

    /// Returns the number of messages that a sealed file says it has; `None` if the file is not sealed.
    pub(super) fn recorded_messages(&self) -> Option<u64> {
        Repeated::read(&self.path)?.messages
    }

    /// Returns the length of the file.
    pub(super) fn length(&self) -> u64 {
        self.source.length()
    }

    /// Returns where the last returned block begins.
    pub(super) fn offset(&self) -> u64 {
        self.offset
    }

    /// Continues with the file as it is now, after its last whole record. Returns false if another file has its place.
    ///
    /// # Errors
    /// [`Error::LogRead`] if the system cannot open it.
    pub(super) fn go_on(&mut self) -> Result<bool, Error> {
        let path = followed(self.path.clone());
        let source = Source::open_at(&path, self.source.end())?;
        let is_same = source.identity() == self.source.identity();
        if is_same {
            (self.path, self.source, self.tail) = (path, source, None);
        }
        Ok(is_same)
    }

    /// Returns whether another file has the place of this one.
    pub(super) fn is_replaced(&self) -> bool {
        let found = followed(self.path.clone()).metadata();
        found.is_ok_and(|found| durable::identity(&found) != self.source.identity())
    }

    /// Returns the messages of the chunk that begins at `offset`, whose channels this scanner has read before.
    ///
    /// # Errors
    /// [`Error::LogRead`] if there is no such chunk any more, or it is damaged.
    pub(super) fn chunk_at(&self, offset: u64) -> Result<Vec<Message>, Error> {
        let path = followed(self.path.clone());
        let failed =
            |reason: &str| Err(read_error(&path, format!("chunk at byte {offset}: {reason}")));
        let mut source = Source::open_at(&path, offset)?;
        let Frame::Record { kind: op::CHUNK, content, .. } = source.next(&path)? else {
            return failed("expected a chunk, found something else");
        };
        let mut directory = self.directory.clone();
        directory.forgive();
        let mut found = ChunkContents::default();
        let take = |kind, content: &[u8]| directory.take(kind, content, &mut found);
        match Chunks::default().open(content, take) {
            Ok(()) => Ok(found.messages),
            Err(Trouble::Damage(reason) | Trouble::Foreign(reason)) => failed(&reason),
        }
    }

    /// Returns whether a living writer has the file, or one has extended it since this scanner opened it.
    pub(super) fn is_being_written(&self) -> bool {
        let file = self.source.file();
        let is_locked = match file.try_lock_shared() {
            Ok(()) => {
                file.unlock().ok();
                false
            }
            Err(cause) => matches!(cause, TryLockError::WouldBlock),
        };
        is_locked || file.metadata().is_ok_and(|now| now.len() > self.source.length())
    }

    /// Returns the next block; `None` at the end of what can be read.
    ///
    /// # Errors
    /// [`Error::LogRead`] if the system cannot read the file, or if a topic of ours has messages
    /// that are not ours. Damage is no error here.
    pub(super) fn next_block(&mut self) -> Result<Option<Block>, Error> {
        if let Some(block) = self.held.pop_front() {
            return Ok(Some(block));
        }
        while self.tail.is_none() {
            let Scanner { path, source, chunks, directory, .. } = self;
            let (content, kind, offset) = match source.next(path)? {
                Frame::Record { content, kind, offset } => (content, kind, offset),
                Frame::End(tail) => {
                    self.tail = Some(tail);
                    break;
                }
            };
            self.offset = offset;
            let mut found = ChunkContents::default();
            let taken = match kind {
                op::CHUNK => {
                    chunks.open(content, |kind, content| directory.take(kind, content, &mut found))
                }
                _ => directory.take(kind, content, &mut found),
            };
            match taken {
                Ok(()) => {}
                Err(Trouble::Foreign(message)) => {
                    return Err(read_error(path, format!("byte {offset}: {message}")));
                }
                Err(Trouble::Damage(reason)) => {
                    directory.forgive();
                    if directory.channels.is_empty() && !self.summary_read {
                        self.summary_read = true;
                        directory.adopt(Repeated::read(path), true);
                    }
                    return Ok(Some(Block::Damage(Damage { offset, reason })));
                }
            }
            let messages = Block::Messages(found.messages);
            if found.gap > 0 {
                self.held.push_back(messages);
                let reason = format!("{} messages before this byte are missing", found.gap);
                return Ok(Some(Block::Damage(Damage { offset, reason })));
            }
            if !matches!(&messages, Block::Messages(messages) if messages.is_empty()) {
                return Ok(Some(messages));
            }
        }
        Ok(None)
    }
}

/// What a chunk, or a record outside of chunks, holds.
#[derive(Default)]
struct ChunkContents {
    messages: Vec<Message>,
    /// Number of messages missing before these, without known damage to explain it.
    gap: u64,
}

/// The schemas and channels of a file so far, and the next message number of each channel.
#[derive(Clone, Default)]
struct Directory {
    schemas: BTreeMap<u16, String>,
    channels: BTreeMap<u16, Channel>,
    missing: u64,
}

#[derive(Clone)]
struct Channel {
    /// `None` for a topic that is not ours, which anybody may add to a file.
    topic: Option<Topic>,
    next: u32,
    /// Whether only the summary has declared it so far, which may be damaged.
    is_adopted: bool,
    /// Whether damage was found since its last message, so that a gap in its numbers is not reported again.
    forgiven: bool,
}

impl Directory {
    /// Takes in a record that is not a chunk.
    fn take(&mut self, kind: u8, content: &[u8], found: &mut ChunkContents) -> Result<(), Trouble> {
        if !matches!(kind, op::SCHEMA | op::CHANNEL | op::MESSAGE) {
            return Ok(());
        }
        if kind != op::MESSAGE && content.len() > LONGEST_DECLARATION {
            let found = content.len();
            return Err(Trouble::Damage(format!(
                "record of kind {kind:#04x}: expected up to {LONGEST_DECLARATION} bytes, found {found}"
            )));
        }
        let record = record::parse(kind, content)
            .map_err(|cause| Trouble::Damage(format!("record of kind {kind:#04x}: {cause}")))?;
        match record {
            records::Record::Schema { header, .. } => {
                let protobuf = header.encoding == "protobuf";
                let name =
                    if protobuf { header.name } else { format!("{} schema", header.encoding) };
                let name = name.chars().take(LETTERS_KEPT).collect();
                self.schemas.entry(header.id).or_insert(name);
                Ok(())
            }
            records::Record::Channel(channel) => self.take_channel(channel),
            records::Record::Message { header, data } => self.take_message(&header, &data, found),
            _ => Ok(()),
        }
    }

    fn take_channel(&mut self, channel: records::Channel) -> Result<(), Trouble> {
        let known = self.channels.get(&channel.id);
        // The summary declares it again. If it differs there, the summary's checksum says so.
        if known.is_some_and(|known| !known.is_adopted) {
            return Ok(());
        }
        let (next, forgiven) = known.map_or((0, false), |known| (known.next, known.forgiven));
        let topic = Topic::named(&channel.topic);
        if let Some(topic) = topic {
            let schema = self.schemas.get(&channel.schema_id).map_or("none", String::as_str);
            if schema != topic.schema() || channel.message_encoding != "protobuf" {
                let (name, expected) = (topic.name(), topic.schema());
                return Err(Trouble::Foreign(format!(
                    "topic {name}: expected protobuf messages {expected}, found {} messages {schema}",
                    channel.message_encoding,
                )));
            }
        }
        self.channels.insert(channel.id, Channel { topic, next, is_adopted: false, forgiven });
        Ok(())
    }

    fn take_message(
        &mut self,
        header: &MessageHeader,
        data: &[u8],
        found: &mut ChunkContents,
    ) -> Result<(), Trouble> {
        let Some(channel) = self.channels.get_mut(&header.channel_id) else {
            let id = header.channel_id;
            return Err(Trouble::Damage(format!("message of channel {id}, which is not declared")));
        };
        let Some(topic) = channel.topic else { return Ok(()) };
        let gap = u64::from(header.sequence.saturating_sub(channel.next));
        self.missing += gap;
        found.gap += if channel.forgiven { 0 } else { gap };
        (channel.next, channel.forgiven) = (header.sequence.wrapping_add(1), false);
        let (log_time_ns, bytes) = (header.log_time, Bytes::copy_from_slice(data));
        found.messages.push(Message { topic, log_time_ns, bytes });
        Ok(())
    }

    /// Takes the channels from the summary of a sealed file, for a file whose beginning is damaged.
    fn adopt(&mut self, repeated: Option<Repeated>, forgiven: bool) {
        for (id, topic) in repeated.into_iter().flat_map(|repeated| repeated.directory.topics()) {
            self.channels.insert(id, Channel { topic, next: 0, is_adopted: true, forgiven });
        }
    }

    /// Returns the topic of each channel.
    fn topics(self) -> impl Iterator<Item = (u16, Option<Topic>)> {
        self.channels.into_iter().map(|(id, channel)| (id, channel.topic))
    }

    /// Notes that damage has been reported, so that what it took is not reported again.
    fn forgive(&mut self) {
        for channel in self.channels.values_mut() {
            channel.forgiven = true;
        }
    }
}

/// What the summary of a sealed file repeats and counts.
struct Repeated {
    directory: Directory,
    messages: Option<u64>,
}

impl Repeated {
    /// Reads the summary of a file, whatever its checksum says; `None` if it is missing or not readable.
    fn read(path: &Path) -> Option<Repeated> {
        let summary = Summary::read(path)?;
        let mut repeated = Repeated { directory: Directory::default(), messages: None };
        each(&summary.records, |kind, content| repeated.take(kind, content)).ok()?;
        Some(repeated)
    }

    fn take(&mut self, kind: u8, content: &[u8]) -> Result<(), Trouble> {
        if kind == op::STATISTICS {
            self.messages = content.first_chunk().map(|bytes| u64::from_le_bytes(*bytes));
        }
        self.directory.take(kind, content, &mut ChunkContents::default())
    }
}
