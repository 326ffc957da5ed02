//! Exit codes: 0 all well, 1 failure, 2 wrong usage, 3 finished but data was lost, 130 stopped by the
//! user before all was done.

use std::fmt::Display;
use std::process::ExitCode;

/// Exit code of wrong usage; clap uses the same for unknown flags.
pub const WRONG_USAGE: u8 = 2;

/// Exit code of a command that finished although data was lost.
const DATA_LOST: u8 = 3;

/// Exit code of a command that the user stopped, so that no script takes it for finished; shells use the same for
/// Ctrl-C.
pub const STOPPED: u8 = 130;

/// An error that is not a plain failure.
#[derive(Debug, thiserror::Error)]
pub enum Refusal {
    /// The user asked for something that cannot be done; nothing was begun or changed.
    #[error("{0}")]
    WrongUsage(String),
    /// The command finished, but not everything that was recorded is there.
    #[error("{0}")]
    DataLost(String),
    /// The command ends with this code; the reason has already been printed.
    #[error("ended with exit code {0}")]
    Explained(u8),
}

impl Refusal {
    /// Turns an error, with its causes, into one of wrong usage.
    pub fn usage(error: impl Into<anyhow::Error>) -> Refusal {
        Refusal::WrongUsage(format!("{:#}", error.into()))
    }

    /// Returns the error for a program that ended with this code. The codes that processes of a run have for their
    /// supervisor, and that of a panic, are plain failures.
    pub fn explained_by(code: u8) -> Refusal {
        Refusal::Explained(if [WRONG_USAGE, DATA_LOST, STOPPED].contains(&code) { code } else { 1 })
    }
}

/// Returns an error of wrong usage, in one line.
pub fn wrong_usage(message: impl Display) -> anyhow::Error {
    Refusal::WrongUsage(message.to_string()).into()
}

/// Returns the error for a command that the user stopped; the user has already been told.
pub fn stopped() -> anyhow::Error {
    Refusal::Explained(STOPPED).into()
}

/// Returns whether the user has already been told about the error.
pub fn is_explained(error: &anyhow::Error) -> bool {
    matches!(error.downcast_ref(), Some(Refusal::Explained(_)))
}

/// Returns the exit code for an error.
pub fn exit_code(error: &anyhow::Error) -> ExitCode {
    use protocol::Error::{Configuration, ConfigurationText, NotARun};
    for cause in error.chain() {
        match cause.downcast_ref() {
            Some(Refusal::WrongUsage(_)) => return WRONG_USAGE.into(),
            Some(Refusal::DataLost(_)) => return DATA_LOST.into(),
            Some(Refusal::Explained(code)) => return (*code).into(),
            None => {}
        }
        if let Some(Configuration { .. } | ConfigurationText { .. } | NotARun { .. }) =
            cause.downcast_ref()
        {
            return WRONG_USAGE.into();
        }
    }
    ExitCode::FAILURE
}

#[cfg(test)]
mod tests {
    use anyhow::Context;
    use protocol::error::within;

    use super::*;

    #[test]
    fn exit_codes_survive_added_context() {
        let plain = Err::<(), _>(anyhow::anyhow!("the disk is gone")).context("training");
        assert_eq!(exit_code(&plain.unwrap_err()), ExitCode::FAILURE);
        let usage = Err::<(), _>(wrong_usage("no such run")).context("training");
        assert_eq!(exit_code(&usage.unwrap_err()), ExitCode::from(2));
        let unknown = within("task", false, "one there is", "fetch").context("training");
        assert_eq!(exit_code(&unknown.unwrap_err()), ExitCode::from(2));
        let lost = anyhow::Error::from(Refusal::DataLost("2 records".to_owned()));
        assert_eq!(exit_code(&lost), ExitCode::from(3));
        let explained = anyhow::Error::from(Refusal::Explained(5));
        assert_eq!((exit_code(&explained), is_explained(&explained)), (ExitCode::from(5), true));
        assert!(!is_explained(&lost));
        for (code, shown) in [(2, 2), (3, 3), (130, 130), (1, 1), (4, 1), (101, 1)] {
            let explained = anyhow::Error::from(Refusal::explained_by(code));
            assert_eq!(exit_code(&explained), ExitCode::from(shown));
        }
    }
}
