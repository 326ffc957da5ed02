//! Seals a file that a crash or a bad disk left, for `goalward log repair` and for resuming.
//!
//! All messages in intact chunks go to a new file, including those after damage. If the metadata is damaged, the new
//! file gets what the other files of the run agree on. The new file is read back before it gets the name. The original
//! is kept if anything in it could not be copied.

use std::collections::BTreeMap;
use std::fs::{self, File, TryLockError};
use std::path::{Path, PathBuf};
use std::{fmt, io};

use protocol::{Error, durable};

use super::file::FileWriter;
use super::folder::{ACTIVE, is_active, sync_folder_of, with_ending};
use super::metadata::Metadata;
use super::reader::{Ending, FileReader};
use super::scan::{Block, Scanner};
use super::siblings::settled;
use super::source::{Damage, Tail};
use super::topic::Topic;
use super::{read_error, write_error};

/// Ending that is added to the original's name if something in it is lost.
const DAMAGED: &str = "damaged";
/// Ending that is added to the new file's name until it has been read back.
const REPAIRING: &str = "repairing";

/// What [`repair`] did.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Repair {
    /// The file that was to be repaired.
    pub original: PathBuf,
    /// The sealed file; `None` if there was nothing to keep.
    pub sealed: Option<PathBuf>,
    /// Number of messages kept, for each topic that has any.
    pub kept: BTreeMap<Topic, u64>,
    /// What was wrong, with the byte it starts at; empty if the file was only not sealed.
    pub damage: Vec<String>,
    /// Number of messages known to be lost. Damage at the end of a file hides how many it took.
    pub lost: u64,
    /// Where the original is kept, if something in it is lost.
    pub damaged: Option<PathBuf>,
}

impl Repair {
    fn note(&mut self, Damage { offset, reason }: Damage) {
        self.damage.push(format!("byte {offset}: {reason}"));
    }
}

impl fmt::Display for Repair {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let messages: u64 = self.kept.values().sum();
        write!(formatter, "{}: kept {messages} messages", self.original.display())?;
        if let Some(sealed) = &self.sealed {
            write!(formatter, " in {}", sealed.display())?;
        }
        for damage in &self.damage {
            write!(formatter, "; {damage}")?;
        }
        if self.lost > 0 {
            write!(formatter, "; at least {} messages are lost", self.lost)?;
        }
        if let Some(damaged) = &self.damaged {
            write!(formatter, "; the original is {}", damaged.display())?;
        }
        Ok(())
    }
}

/// Seals a file. A file that is sealed and intact stays as it is. `PATH.active` becomes `PATH`.
///
/// A repair that died can be repeated: the original is there until the new file has its place, and what exists of both
/// is recognized.
///
/// # Errors
/// [`Error::LogRead`] as [`FileReader::open`], if the file is being written, or if another file has the sealed name;
/// [`Error::LogWrite`] if the new file cannot be written. The original is then unchanged.
pub fn repair(path: &Path) -> Result<Repair, Error> {
    let _held = hold(path)?;
    let target = sealed_path(path);
    let mut repair = Repair {
        original: path.to_owned(),
        sealed: None,
        kept: BTreeMap::new(),
        damage: Vec::new(),
        lost: 0,
        damaged: None,
    };
    if target != path && target.exists() {
        finish(path, &target, &mut repair)?;
        repair.sealed = Some(target);
        return Ok(repair);
    }
    match inspect(path, &mut repair)? {
        State::Begun => {
            repair.damage.push("it ends before its metadata".to_owned());
            repair.damaged = Some(set_aside(path)?);
            return Ok(repair);
        }
        State::Sealed => {}
        State::Open(metadata, topics) => {
            let draft = with_ending(&target, REPAIRING);
            write_anew(path, &draft, &metadata, &topics, &mut repair)?;
            verify(&draft, &repair)?;
            replace(path, &target, &draft, &mut repair)?;
        }
    }
    repair.sealed = Some(target);
    Ok(repair)
}

/// Locks the file against other repairs, and refuses one that its writer still holds.
fn hold(path: &Path) -> Result<File, Error> {
    use io::ErrorKind::{PermissionDenied, ReadOnlyFilesystem};
    // NFS grants an exclusive lock only if the file is open for writing.
    let opened = File::options().read(true).write(true).open(path);
    let opened = opened.or_else(|cause| match cause.kind() {
        PermissionDenied | ReadOnlyFilesystem => File::open(path),
        _ => Err(cause),
    });
    let file = opened.map_err(|cause| read_error(path, format!("cannot open: {cause}")))?;
    match durable::try_lock(&file) {
        Err(TryLockError::WouldBlock) => {
            Err(read_error(path, "expected a file that no process writes, found one being written"))
        }
        // If the file system has no locks, the run's own lock must do.
        Ok(()) | Err(TryLockError::Error(_)) => Ok(file),
    }
}

/// What a file is, before it is repaired.
enum State {
    /// It ends before its metadata.
    Begun,
    /// It is sealed, also by its name, and intact.
    Sealed,
    /// Anything else: it is to be written anew, with this metadata, for messages of these topics.
    Open(Metadata, Vec<Topic>),
}

/// Reads a file. Notes what an intact one holds.
fn inspect(path: &Path, repair: &mut Repair) -> Result<State, Error> {
    let Some(mut reader) = FileReader::open_begun(path)? else { return Ok(State::Begun) };
    let mut kept = BTreeMap::new();
    while let Some(message) = reader.next_message()? {
        *kept.entry(message.topic).or_insert(0) += 1;
    }
    // A complete file that is still `.active` may not be on the disk: its writer died before the sync, or that failed.
    if reader.ending() == Some(&Ending::Complete) && sealed_path(path) == path {
        repair.kept = kept;
        return Ok(State::Sealed);
    }
    let own = reader.metadata();
    let metadata = match reader.doubts_metadata() {
        // The new file has right checksums, so nobody could tell later that its metadata is damaged.
        true => settled(path, own),
        false => own.clone(),
    };
    if metadata != *own {
        let replaced =
            "its metadata, which no other file of the run has, is now what they agree on";
        repair.damage.push(replaced.to_owned());
    }
    let declared = reader.topics();
    let topics = if declared.is_empty() { Topic::ALL.to_vec() } else { declared };
    Ok(State::Open(metadata, topics))
}

/// Writes everything that can be read to a new file.
fn write_anew(
    path: &Path,
    draft: &Path,
    metadata: &Metadata,
    topics: &[Topic],
    repair: &mut Repair,
) -> Result<(), Error> {
    for stale in [draft.to_owned(), with_ending(draft, ACTIVE)] {
        fs::remove_file(stale).ok();
    }
    let Some(mut scanner) = Scanner::open(path)? else {
        return Err(read_error(path, "expected the metadata that was there before, found none"));
    };
    let mut writer = FileWriter::create(draft, metadata, topics)?;
    let copied = copy(&mut scanner, &mut writer, repair).and_then(|()| writer.seal());
    if copied.is_err() {
        // The original has everything; the draft would only take room.
        writer.discard().ok();
    }
    copied
}

/// Copies what can be read, and notes what cannot.
fn copy(scanner: &mut Scanner, writer: &mut FileWriter, repair: &mut Repair) -> Result<(), Error> {
    note_beginning(scanner, repair);
    while let Some(block) = scanner.next_block()? {
        match block {
            Block::Damage(damage) => repair.note(damage),
            Block::Messages(messages) => {
                for message in messages {
                    writer.message(message.topic, message.log_time_ns, &message.bytes)?;
                    *repair.kept.entry(message.topic).or_insert(0) += 1;
                }
            }
        }
    }
    note_tail(scanner, repair);
    Ok(())
}

/// Notes that the beginning cannot be read.
fn note_beginning(scanner: &Scanner, repair: &mut Repair) {
    if let Some(unread) = scanner.unread() {
        repair.note(unread.damage.clone());
    }
}

/// Notes what is missing at the end.
fn note_tail(scanner: &Scanner, repair: &mut Repair) {
    repair.lost = scanner.missing();
    match scanner.tail() {
        Some(Tail::Cut { offset, bytes }) => {
            repair.damage.push(format!("byte {offset}: cut off, the last {bytes} bytes are lost"));
        }
        Some(Tail::Lost(damage) | Tail::Altered(damage)) => {
            repair.note(damage.clone());
        }
        Some(Tail::Unsealed) if !is_active(&repair.original) => {
            repair.damage.push(format!("byte {}: its end is missing", scanner.length()));
        }
        Some(Tail::Sealed | Tail::Unsealed) | None => {}
    }
}

/// Reads the new file back.
fn verify(draft: &Path, repair: &Repair) -> Result<(), Error> {
    let mut reader = FileReader::open(draft)?;
    let mut found = BTreeMap::new();
    while let Some(message) = reader.next_message()? {
        *found.entry(message.topic).or_insert(0) += 1;
    }
    match reader.ending() {
        Some(Ending::Complete) if found == repair.kept => Ok(()),
        ending => {
            let message = format!(
                "expected the repaired file to read back {:?}, found {found:?}, {ending:?}",
                repair.kept
            );
            Err(read_error(draft, message))
        }
    }
}

/// Puts the new file in the original's place. At every moment one of them is there.
fn replace(path: &Path, target: &Path, draft: &Path, repair: &mut Repair) -> Result<(), Error> {
    if path == target && !repair.damage.is_empty() {
        repair.damaged = Some(link_aside(path)?);
    }
    durable::rename(draft, target)
        .map_err(|cause| write_error(target, "name the repaired file", &cause))?;
    if path == target { Ok(()) } else { put_away(path, repair) }
}

/// Removes the original once the repaired file has its place, or sets it aside if it was damaged.
fn put_away(path: &Path, repair: &mut Repair) -> Result<(), Error> {
    if !repair.damage.is_empty() {
        repair.damaged = Some(set_aside(path)?);
        return Ok(());
    }
    fs::remove_file(path).map_err(|cause| write_error(path, "remove the unsealed file", &cause))?;
    sync_folder_of(path)
}

/// Completes a repair that died after the new file got its place and before the original was removed.
fn finish(path: &Path, target: &Path, repair: &mut Repair) -> Result<(), Error> {
    let differs = || {
        let target = target.display();
        read_error(path, format!("expected to seal it as {target}, which has something else"))
    };
    let mut sealed = FileReader::open(target)?;
    if let Some(mut scanner) = Scanner::open(path)? {
        note_beginning(&scanner, repair);
        while let Some(block) = scanner.next_block()? {
            match block {
                Block::Damage(damage) => repair.note(damage),
                Block::Messages(messages) => {
                    for message in messages {
                        let found = sealed.next_message()?;
                        if found.as_ref() != Some(&message) {
                            return Err(differs());
                        }
                        *repair.kept.entry(message.topic).or_insert(0) += 1;
                    }
                }
            }
        }
        note_tail(&scanner, repair);
    }
    if sealed.next_message()?.is_some() || sealed.ending() != Some(&Ending::Complete) {
        return Err(differs());
    }
    put_away(path, repair)
}

/// Gives a file a second name; it also keeps its own.
fn link_aside(path: &Path) -> Result<PathBuf, Error> {
    let failed = |cause| write_error(path, "keep the damaged file", &cause);
    let mut names = names_aside(path);
    // A repair that died may have linked it already.
    let is_free = |name: &PathBuf| !name.exists() || is_same_file(name, path);
    let aside = names.find(is_free).expect("names do not end");
    if !aside.exists() {
        // Some file systems have no hard links.
        fs::hard_link(path, &aside).or_else(|_| durable::copy(path, &aside)).map_err(failed)?;
    }
    sync_folder_of(&aside)?;
    Ok(aside)
}

fn is_same_file(one: &Path, other: &Path) -> bool {
    let identity = |path: &Path| path.metadata().map(|file| durable::identity(&file)).ok();
    identity(one).is_some() && identity(one) == identity(other)
}

fn set_aside(path: &Path) -> Result<PathBuf, Error> {
    let aside = names_aside(path).find(|name| !name.exists()).expect("names do not end");
    durable::rename(path, &aside).map_err(|cause| write_error(path, "put it aside", &cause))?;
    Ok(aside)
}

/// Returns possible names for the damaged original.
fn names_aside(path: &Path) -> impl Iterator<Item = PathBuf> {
    let numbered = (1..).map(move |number| with_ending(path, &format!("{DAMAGED}-{number}")));
    std::iter::once(with_ending(path, DAMAGED)).chain(numbered)
}

/// Returns `path` without `.active`.
fn sealed_path(path: &Path) -> PathBuf {
    if is_active(path) { path.with_extension("") } else { path.to_owned() }
}
