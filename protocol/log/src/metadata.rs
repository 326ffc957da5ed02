//! The first record of every file: what the file is, for which task, and how it was made.
//!
//! It comes first because a crash costs the end of a file.

use std::collections::BTreeMap;

use protocol::build::Build;

use super::record::Trouble;

/// The layout of topics and metadata that this build writes, and the newest one that it reads.
const FORMAT_VERSION: u32 = 1;

/// The kind of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// The log of a run.
    Run,
    /// Demonstrations of a task.
    Demonstrations,
}

impl Kind {
    /// Every kind.
    pub const ALL: [Kind; 2] = [Kind::Run, Kind::Demonstrations];

    /// Returns the name of the metadata record.
    pub fn name(self) -> &'static str {
        match self {
            Kind::Run => "goalward.run",
            Kind::Demonstrations => "goalward.demonstrations",
        }
    }
}

/// A file's description of itself.
///
/// Every file has `format_version`, `goalward_version`, `build` as JSON, `task` and `seed`. A run adds its whole
/// effective configuration as `config`; demonstrations add `episodes`, `expert` and `setting`, the last as JSON.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Metadata {
    /// The kind of the file.
    pub kind: Kind,
    /// All other entries, by name.
    pub entries: BTreeMap<String, String>,
}

impl Metadata {
    /// Creates the metadata of a new file, with the entries that every file has.
    pub fn new(kind: Kind, task: &str, seed: u64) -> Self {
        let build = serde_json::to_string(Build::own()).expect("a build has only plain values");
        Metadata { kind, entries: BTreeMap::new() }
            .with("format_version", FORMAT_VERSION)
            .with("goalward_version", env!("CARGO_PKG_VERSION"))
            .with("build", build)
            .with("task", task)
            .with("seed", seed)
    }

    /// Adds an entry.
    pub fn with(mut self, name: &str, value: impl ToString) -> Self {
        self.entries.insert(name.to_owned(), value.to_string());
        self
    }

    /// Returns the entry called `name`.
    pub fn get(&self, name: &str) -> Option<&str> {
        self.entries.get(name).map(String::as_str)
    }

    /// Returns the build that wrote the file; the unknown one if the file does not say.
    pub fn build(&self) -> Build {
        let build = self.get("build").and_then(|text| serde_json::from_str(text).ok());
        build.unwrap_or_default()
    }

    /// Checks a metadata record of a file; the error says what was expected and found.
    pub(super) fn check(name: &str, entries: BTreeMap<String, String>) -> Result<Self, Trouble> {
        let Some(kind) = Kind::ALL.into_iter().find(|kind| kind.name() == name) else {
            return Err(Trouble::Damage(not_ours(&format!("metadata `{name}`"))));
        };
        let metadata = Metadata { kind, entries };
        let version = metadata.get("format_version").unwrap_or("none");
        let number = version.parse::<u32>();
        if number.as_ref().is_ok_and(|number| *number <= FORMAT_VERSION) {
            return Ok(metadata);
        }
        let message = format!(
            "expected format version {FORMAT_VERSION} or older, found {version} (written by \
             goalward {})",
            metadata.get("goalward_version").unwrap_or("of unknown version"),
        );
        // Nothing is known of a newer format, not even whether its records may be read.
        Err(if number.is_ok() { Trouble::Foreign(message) } else { Trouble::Damage(message) })
    }
}

/// Returns the message for an MCAP file that is not ours.
pub(super) fn not_ours(found: &str) -> String {
    let [run, demonstrations] = Kind::ALL.map(Kind::name);
    format!(
        "not recorded by goalward: expected metadata `{run}` or `{demonstrations}` as the first \
         record, found {found}"
    )
}
