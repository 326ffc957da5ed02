//! The one error type of this crate; every message says what was expected and what was found.

use std::path::PathBuf;

use crate::dropped::shortened;

/// Longest wrong value in an error, characters.
pub const FOUND_CHARS: usize = 80;

/// Longest words of a parser in an error, characters.
pub const MESSAGE_CHARS: usize = 300;

/// What can go wrong while processes talk, record or read a configuration.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// Bytes that are not the message they should be.
    #[error("undecodable {what}")]
    Undecodable {
        /// The message expected.
        what: &'static str,
        /// What the decoder met.
        source: prost::DecodeError,
    },
    /// A trajectory that does not fit its task.
    #[error("trajectory: expected {what} {expected}, found {found}")]
    Trajectory {
        /// The part that does not fit.
        what: &'static str,
        /// What the task's shapes ask for.
        expected: String,
        /// What the trajectory has.
        found: String,
    },
    /// A configuration value outside its range.
    #[error("configuration: `{key}` must be {expected}, found {found}")]
    Configuration {
        /// The dotted key.
        key: String,
        /// The values allowed.
        expected: String,
        /// The value found.
        found: String,
    },
    /// A setting that its environment does not have.
    #[error("{message}")]
    Setting {
        /// What the environment expects, with the key.
        message: String,
    },
    /// Text that is no configuration of ours.
    #[error("configuration {origin}: {message}")]
    ConfigurationText {
        /// File, preset or flag it comes from.
        origin: String,
        /// What the parser met, with the key.
        message: String,
    },
    /// The transport failed.
    #[error("bus: {operation} of service `{service}` failed: {message}")]
    Bus {
        /// What was tried.
        operation: &'static str,
        /// The service's name.
        service: String,
        /// iceoryx2's own words.
        message: String,
    },
    /// A file or folder of the bus that cannot be used, or is in its way.
    #[error("bus: {}: {message}", path.display())]
    BusFile {
        /// The file.
        path: PathBuf,
        /// What was expected and what was met.
        message: String,
    },
    /// A log file that does not take what it was given. That is kept in memory, and written when the
    /// disk takes it.
    #[error("log {}: {message}", path.display())]
    LogWrite {
        /// The file.
        path: PathBuf,
        /// What the writer met.
        message: String,
    },
    /// A message that is not in its log file and will not be.
    #[error("log {}: refused, not recorded: {message}", path.display())]
    LogRefused {
        /// The file.
        path: PathBuf,
        /// What was expected and what was found.
        message: String,
    },
    /// A log file that the disk took and did not sync. The system tells of that once, and drops what was to be
    /// written: no later attempt says whether it is there.
    #[error("log {}: {message}", path.display())]
    LogUnsynced {
        /// The file.
        path: PathBuf,
        /// What the writer met.
        message: String,
    },
    /// A log file that cannot be read.
    #[error("log {}: {message}", path.display())]
    LogRead {
        /// The file.
        path: PathBuf,
        /// What was expected and what was met.
        message: String,
    },
    /// An update in a log without all that it learned from.
    #[error("iteration {iteration}: expected its whole batch in the log")]
    Batch {
        /// The update's iteration.
        iteration: u64,
    },
    /// Demonstrations that a run cannot learn from.
    #[error("demonstrations {}: {message}", path.display())]
    Demonstrations {
        /// The file.
        path: PathBuf,
        /// What was expected and what was met.
        message: String,
    },
    /// A folder that holds no run.
    #[error("{} is not a run: {message}", path.display())]
    NotARun {
        /// The folder.
        path: PathBuf,
        /// What was expected.
        message: String,
    },
    /// A run's folder that is not where it was when the run was opened.
    #[error("the run's folder {} was moved or removed while it was in use; what is left of the run goes on with \
             --resume from where it is now", path.display())]
    RunMoved {
        /// Where it was.
        path: PathBuf,
    },
    /// A number of actors that cannot be written or read.
    #[error("{}: {message}", path.display())]
    ActorsWanted {
        /// The file.
        path: PathBuf,
        /// What was expected and what was met.
        message: String,
    },
    /// A summary that cannot be written or read.
    #[error("summary {}: {message}", path.display())]
    Summary {
        /// The file.
        path: PathBuf,
        /// What was met.
        message: String,
    },
    /// A checkpoint file that cannot be written or read.
    #[error("checkpoint {}: {message}", path.display())]
    Checkpoint {
        /// The file.
        path: PathBuf,
        /// What was expected and what was met.
        message: String,
    },
}

impl Error {
    /// The same of a configuration's text with where that is from.
    pub fn of_origin(self, origin: &str) -> Error {
        match self {
            Error::ConfigurationText { message, .. } => {
                Error::ConfigurationText { origin: origin.to_owned(), message }
            }
            other => other,
        }
    }

    /// The refusal of a setting, with the part of the configuration that has the setting.
    pub fn of_part(self, part: &str) -> Error {
        match self {
            Error::Configuration { key, expected, found } => {
                Error::Configuration { key: format!("{part}.{key}"), expected, found }
            }
            Error::Setting { message } => {
                Error::ConfigurationText { origin: format!("`{part}`"), message }
            }
            other => other,
        }
    }
}

/// Refuses a configuration value unless it holds.
///
/// # Errors
/// [`Error::Configuration`] with the key, what was expected and what was found.
pub fn within(
    key: &str,
    holds: bool,
    expected: &str,
    found: impl std::fmt::Display,
) -> Result<(), Error> {
    if holds { Ok(()) } else { Err(out_of_range(key, expected, found)) }
}

/// The refusal of a configuration value.
pub fn out_of_range(key: &str, expected: &str, found: impl std::fmt::Display) -> Error {
    Error::Configuration {
        key: key.to_owned(),
        expected: expected.to_owned(),
        found: shortened(&found.to_string(), FOUND_CHARS),
    }
}
