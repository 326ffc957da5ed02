//! Where the programs of a run are: beside `goalward` itself.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Stdio};

use anyhow::{Context, Result, ensure};
use serde::de::DeserializeOwned;

use crate::refusal::Refusal;

/// A program that `goalward` starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Program {
    /// Acts: rollouts, demonstrations, evaluation.
    Actor,
    /// Learns the policy.
    Learner,
    /// Learns the reward.
    ProximityService,
}

impl Program {
    /// Every program.
    pub(crate) const ALL: [Program; 3] =
        [Program::Actor, Program::Learner, Program::ProximityService];

    fn file_name(self) -> &'static str {
        match self {
            Program::Actor => "goalward-actor",
            Program::Learner => "goalward-learner",
            Program::ProximityService => "goalward-proximity-service",
        }
    }

    /// A command that runs it, without arguments yet.
    ///
    /// # Errors
    /// When it is not where it should be.
    pub(crate) fn command(self) -> Result<Command> {
        Ok(Command::new(self.path()?))
    }

    fn path(self) -> Result<PathBuf> {
        let own = std::env::current_exe().context("finding the folder of goalward")?;
        let path = own.with_file_name(self.file_name());
        ensure!(
            path.is_file(),
            "expected the program {} beside goalward; build all programs with `cargo build \
             --release`",
            path.display()
        );
        Ok(path)
    }
}

/// Runs a program that prints its figures as JSON, its diagnostics going where ours go.
///
/// # Errors
/// When it cannot start, fails, or prints something else.
pub(crate) fn figures<T: DeserializeOwned>(program: &mut Command) -> Result<T> {
    figures_of(program, &[])
}

/// The same for a program that reads `input` before it prints.
///
/// # Errors
/// As [`figures`].
pub(crate) fn figures_of<T: DeserializeOwned>(program: &mut Command, input: &[u8]) -> Result<T> {
    let program = program.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::inherit());
    let mut started = program.spawn().context("starting a program")?;
    let written = started.stdin.take().map_or(Ok(()), |mut stdin| stdin.write_all(input));
    let ended = started.wait_with_output().context("waiting for a program")?;
    expect_success(ended.status)?;
    written.context("writing to a program")?;
    serde_json::from_slice(&ended.stdout).context("reading a program's figures")
}

/// Checks how a program ended that has said why, had it failed.
///
/// # Errors
/// When it has failed, with its exit code; that of a program ended by a signal is 1.
pub(crate) fn expect_success(status: ExitStatus) -> Result<()> {
    if status.success() {
        return Ok(());
    }
    let code = status.code().and_then(|code| u8::try_from(code).ok());
    Err(Refusal::Explained(code.unwrap_or(1)).into())
}

/// Checks that every program is there.
///
/// # Errors
/// For the first that is missing.
pub(crate) fn check_all() -> Result<()> {
    Program::ALL.into_iter().try_for_each(|program| program.path().map(drop))
}

/// How the user can call `goalward` again from the same folder.
pub(crate) fn own_command() -> String {
    let own = std::env::current_exe().unwrap_or_else(|_| PathBuf::from("goalward"));
    let current = std::env::current_dir().unwrap_or_default();
    callable_from(&current, &own).display().to_string()
}

/// A program as a shell in the folder `current` takes it, relative where that is shorter.
fn callable_from(current: &Path, program: &Path) -> PathBuf {
    match program.strip_prefix(current) {
        Ok(inside) if inside.components().count() > 1 => inside.to_owned(),
        Ok(inside) => Path::new(".").join(inside),
        Err(_) => program.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn programs_are_named_as_a_shell_takes_them() {
        let program = Path::new("/work/target/release/goalward");
        let from = |current| callable_from(Path::new(current), program);
        assert_eq!(from("/work"), Path::new("target/release/goalward"));
        assert_eq!(from("/work/target/release"), Path::new("./goalward"));
        assert_eq!(from("/home"), program);
    }
}
