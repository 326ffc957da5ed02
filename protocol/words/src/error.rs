//! The error type of this crate. Every message says what was expected and what was found.

use std::path::PathBuf;

use crate::dropped::shortened;

/// Maximum length of a wrong value quoted in an error, in characters.
pub const FOUND_CHARS: usize = 80;

/// Maximum length of a parser's message quoted in an error, in characters.
pub const MESSAGE_CHARS: usize = 300;

/// An error in communication, recording or configuration.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// Bytes that do not decode to the expected message.
    #[error("undecodable {what}")]
    Undecodable {
        /// The expected message.
        what: &'static str,
        /// The decoder's error.
        source: prost::DecodeError,
    },
    /// A trajectory that does not fit its task.
    #[error("trajectory: expected {what} {expected}, found {found}")]
    Trajectory {
        /// The part that does not fit.
        what: &'static str,
        /// What the task's shapes require.
        expected: String,
        /// What the trajectory has.
        found: String,
    },
    /// A configuration value outside its range.
    #[error("configuration: `{key}` must be {expected}, found {found}")]
    Configuration {
        /// The dotted key.
        key: String,
        /// The allowed values.
        expected: String,
        /// The value found.
        found: String,
    },
    /// A setting that the environment does not accept.
    #[error("{message}")]
    Setting {
        /// What the environment expects, including the key.
        message: String,
    },
    /// Configuration text that cannot be read.
    #[error("configuration {origin}: {message}")]
    ConfigurationText {
        /// The file, preset or flag that the text comes from.
        origin: String,
        /// The parser's message, including the key.
        message: String,
    },
    /// The transport failed.
    #[error("bus: {operation} of service `{service}` failed: {message}")]
    Bus {
        /// The operation that failed.
        operation: &'static str,
        /// The service's name.
        service: String,
        /// The cause: an error of iceoryx2, or a message of our own.
        message: String,
    },
    /// A file or folder of the bus that cannot be used, or something else in its place.
    #[error("bus: {}: {message}", path.display())]
    BusFile {
        /// The file.
        path: PathBuf,
        /// What was expected and what was found.
        message: String,
    },
    /// A failed write to a log. Data already handed over stays in memory until the disk accepts it.
    #[error("log {}: {message}", path.display())]
    LogWrite {
        /// The file.
        path: PathBuf,
        /// What failed.
        message: String,
    },
    /// A message that was not recorded and will not be.
    #[error("log {}: refused, not recorded: {message}", path.display())]
    LogRefused {
        /// The file.
        path: PathBuf,
        /// What was expected and what was found.
        message: String,
    },
    /// A failed sync of a log file. The operating system reports it once and drops the unwritten data, so no later
    /// sync can tell whether the data is on the disk.
    #[error("log {}: {message}", path.display())]
    LogUnsynced {
        /// The file.
        path: PathBuf,
        /// What failed.
        message: String,
    },
    /// A log file that cannot be read.
    #[error("log {}: {message}", path.display())]
    LogRead {
        /// The file.
        path: PathBuf,
        /// What was expected and what was found.
        message: String,
    },
    /// A policy update in a log that lacks part of the update's batch.
    #[error(
        "iteration {iteration}: expected lane {lane} episode {episode} of its batch in the log, found none"
    )]
    Batch {
        /// The update's iteration.
        iteration: u64,
        /// Lane of the first trajectory that is missing.
        lane: u64,
        /// Episode of the first trajectory that is missing.
        episode: u64,
    },
    /// Demonstrations that a run cannot learn from.
    #[error("demonstrations {}: {message}", path.display())]
    Demonstrations {
        /// The file.
        path: PathBuf,
        /// What was expected and what was found.
        message: String,
    },
    /// A folder that is not a run.
    #[error("{} is not a run: {message}", path.display())]
    NotARun {
        /// The folder.
        path: PathBuf,
        /// What was expected.
        message: String,
    },
    /// A run's folder that was moved or removed after the run was opened.
    #[error("the run's folder {} was moved or removed while it was in use; --resume continues what is left of \
             the run where it is now", path.display())]
    RunMoved {
        /// Where it was.
        path: PathBuf,
    },
    /// A file with the wanted number of actors that cannot be written or read.
    #[error("{}: {message}", path.display())]
    ActorsWanted {
        /// The file.
        path: PathBuf,
        /// What was expected and what was found.
        message: String,
    },
    /// A summary that cannot be written or read.
    #[error("summary {}: {message}", path.display())]
    Summary {
        /// The file.
        path: PathBuf,
        /// What failed.
        message: String,
    },
    /// A checkpoint file that cannot be written or read.
    #[error("checkpoint {}: {message}", path.display())]
    Checkpoint {
        /// The file.
        path: PathBuf,
        /// What was expected and what was found.
        message: String,
    },
}

impl Error {
    /// Sets where the text of an [`Error::ConfigurationText`] comes from. Other errors stay as they are.
    pub fn of_origin(self, origin: &str) -> Error {
        match self {
            Error::ConfigurationText { message, .. } => {
                Error::ConfigurationText { origin: origin.to_owned(), message }
            }
            other => other,
        }
    }

    /// Names the part of the configuration that a refused setting belongs to. Errors of other kinds stay as they are.
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

/// Refuses a configuration value unless `holds`.
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

/// Returns the error that refuses a configuration value.
pub fn out_of_range(key: &str, expected: &str, found: impl std::fmt::Display) -> Error {
    Error::Configuration {
        key: key.to_owned(),
        expected: expected.to_owned(),
        found: shortened(&found.to_string(), FOUND_CHARS),
    }
}
