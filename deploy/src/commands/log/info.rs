//! `goalward log info`: what files hold, and whether they are intact.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::Result;
use mcap_log::{FileInfo, is_active};
use serde::Serialize;

use terminal::refusal::Refusal;

/// What a file holds.
#[derive(Debug, Serialize)]
pub(super) struct Holding {
    pub(super) file: PathBuf,
    /// Whether something in it cannot be read.
    pub(super) lost: bool,
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
        let Some(info) = mcap_log::info(file).map_err(Refusal::usage)? else {
            return Ok(Holding {
                file: file.to_owned(),
                // Nothing is lost from an active file: its writer may just have created it.
                lost: !is_active(file),
                content: None,
                text: format!("{}: ends before it says what it is", file.display()),
            });
        };
        Ok(Holding {
            file: file.to_owned(),
            lost: info.ending.lost(),
            text: info.to_string(),
            content: Some(Content::of(&info)),
        })
    }

    /// Returns a description of several lines; the first has the file and its state.
    pub(super) fn text(&self) -> &str {
        &self.text
    }
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
