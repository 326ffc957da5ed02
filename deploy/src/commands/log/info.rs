//! `goalward log info`: what files hold, and whether they are intact.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Result;
use mcap_log::{FileInfo, is_active};
use protocol::durable;
use serde::Serialize;

use terminal::refusal::Refusal;

/// What a file holds.
#[derive(Debug, Serialize)]
pub(super) struct Holding {
    pub(super) file: PathBuf,
    /// Whether something in it cannot be read.
    pub(super) lost: bool,
    /// Originals that repairs laid aside because something in them could not be kept.
    damaged_originals: Vec<PathBuf>,
    /// `None` for a file that ends before it says what it is.
    #[serde(flatten)]
    content: Option<Content>,
    #[serde(skip)]
    text: String,
}

#[derive(Debug, Serialize)]
struct Content {
    state: &'static str,
    kind: &'static str,
    task: Option<String>,
    seed: Option<u64>,
    build: String,
    /// Number of messages by topic.
    messages: BTreeMap<&'static str, u64>,
    message_bytes: u64,
    file_bytes: u64,
    /// How the file ends.
    ending: String,
}

impl Holding {
    /// Reads a whole file.
    ///
    /// # Errors
    /// Wrong usage, when the file is no log.
    pub(super) fn of(file: &Path) -> Result<Holding> {
        let info = mcap_log::info(file).map_err(Refusal::usage)?;
        let (lost, mut text) = match &info {
            // Nothing is lost from an active file: its writer may just have created it.
            None => {
                (!is_active(file), format!("{}: ends before it says what it is", file.display()))
            }
            Some(info) => (info.ending.lost(), info.to_string()),
        };
        let damaged_originals = damaged_originals(file);
        for original in &damaged_originals {
            text += &format!("\n  repaired with losses, the original is {}", original.display());
        }
        let content = info.as_ref().map(Content::of);
        Ok(Holding { file: file.to_owned(), lost, damaged_originals, content, text })
    }

    /// Returns a description of several lines; the first has the file and its state.
    pub(super) fn text(&self) -> &str {
        &self.text
    }
}

/// Returns the damaged originals of a file, which its repairs leave beside it.
fn damaged_originals(file: &Path) -> Vec<PathBuf> {
    let name = |path: &Path| path.file_name().and_then(OsStr::to_str).map(str::to_owned);
    let Some(own) = name(file) else { return Vec::new() };
    let is_original = |path: &PathBuf| {
        let other = name(path).unwrap_or_default();
        let added = other.strip_prefix(&own).unwrap_or_default();
        added.strip_prefix(".active").unwrap_or(added).starts_with(".damaged")
    };
    let beside = fs::read_dir(durable::folder_of(file)).into_iter().flatten().flatten();
    let mut found: Vec<_> = beside.map(|entry| entry.path()).filter(is_original).collect();
    found.sort();
    found
}

impl Content {
    fn of(info: &FileInfo) -> Content {
        let of = |name| info.metadata.get(name);
        Content {
            state: info.state(),
            kind: info.metadata.kind.name(),
            task: of("task").map(str::to_owned),
            seed: of("seed").and_then(|seed| seed.parse().ok()),
            build: info.metadata.build().to_string(),
            messages: info.messages.iter().map(|(topic, &count)| (topic.name(), count)).collect(),
            message_bytes: info.raw_bytes,
            file_bytes: info.file_bytes,
            ending: info.ending.to_string(),
        }
    }
}
