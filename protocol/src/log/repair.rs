//! Seals a file that a crash or a bad disk left, for `goalward log repair` and for resuming.
//!
//! All messages whose chunk is intact go to a new file, those behind damage too; the new file is
//! read back before it takes the name. The original is kept if anything in it could not be.

use std::collections::BTreeMap;
use std::fmt;
use std::fs;
use std::path::{Path, PathBuf};

use super::file::FileWriter;
use super::folder::{ACTIVE, sync_folder_of, with_ending};
use super::reader::{Ending, FileReader};
use super::scan::{Block, Scanner, Tail};
use super::topic::Topic;
use super::{read_error, write_error};
use crate::Error;

/// What the original has behind its name if something in it is lost.
const DAMAGED: &str = "damaged";
/// What the new file has behind its name until it has been read back.
const REPAIRING: &str = "repairing";

/// What [`repair`] did.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Repair {
    /// The file given.
    pub original: PathBuf,
    /// The sealed file; none if there was nothing to keep.
    pub sealed: Option<PathBuf>,
    /// Messages kept of each topic that has any.
    pub kept: BTreeMap<Topic, u64>,
    /// What was wrong, each with the byte it starts at; empty if the file was only not sealed.
    pub damage: Vec<String>,
    /// Messages that are known to be lost; damage at the end of a file hides how many it took.
    pub lost: u64,
    /// Where the original was put, if something in it is lost.
    pub damaged: Option<PathBuf>,
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

/// Seals a file. A file that is sealed and intact stays as it is.
///
/// Nobody may be writing it. `PATH.active` becomes `PATH`.
///
/// # Errors
/// [`Error::LogRead`] as [`FileReader::open`], or if the sealed name is taken; [`Error::LogWrite`]
/// if the new file cannot be written. The original is then as it was.
pub fn repair(path: &Path) -> Result<Repair, Error> {
    let target = sealed_path(path);
    if target != path && target.exists() {
        let target = target.display();
        return Err(read_error(path, format!("expected to seal it as {target}, which exists")));
    }
    let mut repair = Repair {
        original: path.to_owned(),
        sealed: None,
        kept: BTreeMap::new(),
        damage: Vec::new(),
        lost: 0,
        damaged: None,
    };
    let Some(topics) = inspect(path, &mut repair)? else {
        repair.damage.push("it ends before its metadata".to_owned());
        repair.damaged = Some(set_aside(path)?);
        return Ok(repair);
    };
    if !topics.is_empty() {
        write_anew(path, &target, &topics, &mut repair)?;
    } else if target != path {
        fs::rename(path, &target)
            .map_err(|cause| write_error(path, "rename the sealed file", &cause))?;
        sync_folder_of(&target)?;
    }
    repair.sealed = Some(target);
    Ok(repair)
}

/// Reads a file. Gives the topics to repair it with, none of them if it is intact and sealed, and
/// no answer if the file ends before its metadata.
fn inspect(path: &Path, repair: &mut Repair) -> Result<Option<Vec<Topic>>, Error> {
    let Some(mut reader) = FileReader::open_begun(path)? else { return Ok(None) };
    let mut kept = BTreeMap::new();
    while let Some(message) = reader.next_message()? {
        *kept.entry(message.topic).or_insert(0) += 1;
    }
    if reader.ending() == Some(&Ending::Complete) {
        repair.kept = kept;
        return Ok(Some(Vec::new()));
    }
    let declared = reader.topics();
    Ok(Some(if declared.is_empty() { Topic::ALL.to_vec() } else { declared }))
}

/// Writes all that can be read to a new file and puts that in the original's place.
fn write_anew(
    path: &Path,
    target: &Path,
    topics: &[Topic],
    repair: &mut Repair,
) -> Result<(), Error> {
    let draft = with_ending(target, REPAIRING);
    for stale in [draft.clone(), with_ending(&draft, ACTIVE)] {
        fs::remove_file(stale).ok();
    }
    let Some(mut scanner) = Scanner::open(path)? else {
        return Err(read_error(path, "expected the metadata that was there before, found none"));
    };
    let mut writer = FileWriter::create(&draft, scanner.metadata(), topics)?;
    copy(&mut scanner, &mut writer, repair)?;
    writer.seal()?;
    verify(&draft, repair)?;
    replace(path, target, &draft, repair)
}

/// Copies what can be read, and notes what cannot.
fn copy(scanner: &mut Scanner, writer: &mut FileWriter, repair: &mut Repair) -> Result<(), Error> {
    while let Some(block) = scanner.next_block()? {
        match block {
            Block::Damage(damage) => {
                repair.damage.push(format!("byte {}: {}", damage.offset, damage.reason));
            }
            Block::Messages(messages) => {
                for message in messages {
                    writer.message(message.topic, message.log_time_ns, &message.bytes)?;
                    *repair.kept.entry(message.topic).or_insert(0) += 1;
                }
            }
        }
    }
    repair.lost = scanner.missing();
    match scanner.tail() {
        Some(Tail::Cut { offset, bytes }) => {
            repair.damage.push(format!("byte {offset}: cut off, the last {bytes} bytes are lost"));
        }
        Some(Tail::Lost(damage)) => {
            repair.damage.push(format!("byte {}: {}", damage.offset, damage.reason));
        }
        Some(Tail::Sealed | Tail::Unsealed) | None => {}
    }
    Ok(())
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

/// Puts the new file in the original's place. At no moment is there neither.
fn replace(path: &Path, target: &Path, draft: &Path, repair: &mut Repair) -> Result<(), Error> {
    let intact = repair.damage.is_empty();
    if !intact {
        let aside = free_name(path);
        fs::hard_link(path, &aside)
            .or_else(|_| fs::copy(path, &aside).map(drop))
            .map_err(|cause| write_error(&aside, "keep the damaged file", &cause))?;
        repair.damaged = Some(aside);
    }
    fs::rename(draft, target)
        .map_err(|cause| write_error(target, "name the repaired file", &cause))?;
    if path != target {
        fs::remove_file(path)
            .map_err(|cause| write_error(path, "remove the unsealed file", &cause))?;
    }
    sync_folder_of(target)
}

fn set_aside(path: &Path) -> Result<PathBuf, Error> {
    let aside = free_name(path);
    fs::rename(path, &aside).map_err(|cause| write_error(path, "put the file aside", &cause))?;
    sync_folder_of(&aside)?;
    Ok(aside)
}

/// A name for the damaged original that no file has.
fn free_name(path: &Path) -> PathBuf {
    let numbered = (1..).map(|number| with_ending(path, &format!("{DAMAGED}-{number}")));
    let mut names = std::iter::once(with_ending(path, DAMAGED)).chain(numbered);
    names.find(|name| !name.exists()).expect("names do not end")
}

/// `path` without `.active`.
fn sealed_path(path: &Path) -> PathBuf {
    match path.extension() {
        Some(ending) if ending == ACTIVE => path.with_extension(""),
        _ => path.to_owned(),
    }
}
