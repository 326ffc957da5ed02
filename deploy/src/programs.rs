//! The programs of a run: where they are, beside `goalward` itself, and how one is run to its end. A program that is
//! started here ends with `goalward`, which holds its standard input.

use std::io::Write;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, ExitStatus, Stdio};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};
use protocol::task::Task;
use run::process::INPUT_IS_HELD;
use run::repeat::quoted;
use serde::de::DeserializeOwned;

use crate::headway;
use crate::supervisor::{Signals, runtime};
use terminal::refusal::{Refusal, stopped};
use terminal::status_line::StatusLine;
use terminal::voice;

/// Time between two checks of a program if no signal arrives.
const TICK: Duration = Duration::from_millis(100);

/// Longest time that a program may take to stop.
const STOP_PATIENCE: Duration = Duration::from_secs(1);

/// Settings of our programs' allocator: no huge pages of 2 MiB, which would be little used, and freed memory returns to
/// the system at once. The programs then hold half as much memory and are no slower.
const ALLOCATOR: [(&str, &str); 2] = [("MIMALLOC_ALLOW_THP", "0"), ("MIMALLOC_PURGE_DELAY", "0")];

/// Environment variable with the level of a program's messages.
const LOG_LEVEL: &str = "RUST_LOG";

/// A program that `goalward` starts.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Program {
    /// Acts: rollouts, demonstrations, evaluation.
    Actor,
    /// Acts in a task that brings its own program.
    ActorOfTask(PathBuf),
    /// Learns the policy.
    Learner,
    /// Learns the reward.
    ProximityService,
    /// Carries leases and trajectories to other machines and back; built only on request.
    Gateway,
}

impl Program {
    /// Programs of ours that every run needs.
    pub(crate) const ALL: [Program; 3] =
        [Program::Actor, Program::Learner, Program::ProximityService];

    /// Returns the program that acts in a task.
    pub(crate) fn acting_in(task: &Task) -> Program {
        task.program.clone().map_or(Program::Actor, Program::ActorOfTask)
    }

    /// Returns a command that runs the program, without arguments yet. Its standard input must be a pipe: the program
    /// stops when the pipe closes.
    ///
    /// # Errors
    /// When the program is not where it should be.
    pub(crate) fn command(&self) -> Result<Command> {
        let mut command = Command::new(self.path()?);
        command.env(INPUT_IS_HELD, "1").envs(ALLOCATOR);
        Ok(command)
    }

    /// Returns the program's path.
    ///
    /// # Errors
    /// When the program is not where it should be.
    pub(crate) fn path(&self) -> Result<PathBuf> {
        let name = match self {
            Program::Actor => "goalward-actor",
            Program::Learner => "goalward-learner",
            Program::ProximityService => "goalward-proximity-service",
            Program::Gateway => "goalward-gateway",
            Program::ActorOfTask(path) => {
                let shown = path.display();
                ensure!(path.is_file(), "expected the program {shown}, as the task's file has it");
                return Ok(path.clone());
            }
        };
        let own = std::env::current_exe().context("finding the folder of goalward")?;
        let path = own.with_file_name(name);
        let (build, install) = match self {
            Program::Gateway => (" --package gateway", "gateway"),
            _ => ("", "deploy"),
        };
        ensure!(
            path.is_file(),
            "expected the program {} in goalward's folder; `cargo build --release{build}` builds it, \
             `cargo install --path {install} --locked` installs it",
            path.display()
        );
        Ok(path)
    }

    /// Checks that the program exists.
    ///
    /// # Errors
    /// When it does not, saying how it is built.
    pub(crate) fn check(&self) -> Result<()> {
        self.path().map(drop)
    }
}

/// Runs a program that prints its result as JSON; its diagnostics go where ours go. Shows the progress that it reports,
/// described by `doing`.
///
/// # Errors
/// When the program cannot start, fails, or prints something else.
pub(crate) fn result<T: DeserializeOwned>(program: &mut Command, doing: &'static str) -> Result<T> {
    let mut started = Started::new(program, doing)?;
    let input = started.child.stdin.take();
    let result = started.end()?.result();
    drop(input);
    result
}

/// Does the same as [`result`] for a program that reads `input` before it prints.
///
/// # Errors
/// As [`result`].
pub(crate) fn result_for<T: DeserializeOwned>(
    program: &mut Command,
    doing: &'static str,
    input: &[u8],
) -> Result<T> {
    let mut started = Started::new(program, doing)?;
    let written = started.child.stdin.take().map_or(Ok(()), |mut stdin| stdin.write_all(input));
    let result = started.end()?.result()?;
    written.context("writing to a program")?;
    Ok(result)
}

/// Does the same as [`result`] for a program that takes long. If the user stops it, that is an error, so that callers
/// remove what they have made.
///
/// # Errors
/// As [`result`], and when the user stops it.
pub(crate) fn result_unless_stopped<T: DeserializeOwned>(
    program: &mut Command,
    doing: &'static str,
) -> Result<T> {
    run_unless_stopped(program, doing)?.ok_or_else(stopped)?.result()
}

/// Runs a program to its end, or until the user stops it: then its standard input is closed, and the program ends soon.
/// Shows the progress that it reports, described by `doing`. Returns `None` if the user has stopped it.
///
/// # Errors
/// When the program cannot start.
pub(crate) fn run_unless_stopped(
    program: &mut Command,
    doing: &'static str,
) -> Result<Option<Ended>> {
    attended(program, doing, None)
}

/// Does the same as [`run_unless_stopped`] for a program that reads `input` before it prints. If the user stops it, it
/// is killed, since it does not watch its input.
///
/// # Errors
/// As [`run_unless_stopped`], and when the program does not read its input.
pub(crate) fn run_for_unless_stopped(
    program: &mut Command,
    doing: &'static str,
    input: &[u8],
) -> Result<Option<Ended>> {
    attended(program, doing, Some(input))
}

fn attended(
    program: &mut Command,
    doing: &'static str,
    input: Option<&[u8]>,
) -> Result<Option<Ended>> {
    runtime()?.block_on(async {
        let mut signals = Signals::listen()?;
        // The program has a process group of its own, so that Ctrl-C reaches `goalward` alone.
        let mut started = Started::new(program.process_group(0), doing)?;
        let mut pipe = started.child.stdin.take();
        let written = match input {
            Some(input) => pipe.take().map_or(Ok(()), |mut pipe| pipe.write_all(input)),
            None => Ok(()),
        };
        let stopped = started.attend(&mut signals, pipe).await?;
        let ended = started.end()?;
        if ended.status.success() {
            written.context("writing to a program")?;
        }
        Ok((!stopped).then_some(ended))
    })
}

/// A program that has ended.
pub(crate) struct Ended {
    pub(crate) status: ExitStatus,
    /// What it printed, without its progress.
    printed: Vec<u8>,
}

impl Ended {
    /// Parses the result that the program printed as JSON.
    ///
    /// # Errors
    /// When the program has failed, or printed something else.
    pub(crate) fn result<T: DeserializeOwned>(&self) -> Result<T> {
        expect_success(self.status)?;
        serde_json::from_slice(&self.printed).context("reading a program's result")
    }
}

/// A running program, and the thread that reads what it prints.
struct Started {
    child: Child,
    printed: JoinHandle<std::io::Result<Vec<u8>>>,
}

impl Started {
    fn new(program: &mut Command, doing: &'static str) -> Result<Started> {
        if voice::is_quiet() && std::env::var_os(LOG_LEVEL).is_none() {
            program.env(LOG_LEVEL, "error");
        }
        let program = program.stdin(Stdio::piped()).stdout(Stdio::piped());
        tracing::info!("starting {program:?}");
        let mut child = program.spawn().context("starting a program")?;
        let output = child.stdout.take().context("a program has an output")?;
        let printed = headway::follow(output, doing, StatusLine::new());
        let printed = printed.context("listening to a program")?;
        Ok(Started { child, printed })
    }

    /// Waits until the program has ended; returns whether the user has stopped it. It is asked to by closing `input`.
    async fn attend(&mut self, signals: &mut Signals, input: Option<ChildStdin>) -> Result<bool> {
        const WAITING: &str = "waiting for a program";
        while self.child.try_wait().context(WAITING)?.is_none() {
            tokio::select! {
                () = signals.stop.next() => {
                    let ended = match input {
                        Some(input) => {
                            drop(input);
                            self.expect_end(signals).await
                        }
                        None => self.child.kill(),
                    };
                    return ended.context(WAITING).map(|()| true);
                }
                () = signals.child.next() => {}
                () = tokio::time::sleep(TICK) => {}
            }
        }
        Ok(false)
    }

    /// Waits for the end of a program that was asked to stop, and kills it if it takes too long or the user asks again.
    async fn expect_end(&mut self, signals: &mut Signals) -> std::io::Result<()> {
        let deadline = tokio::time::Instant::now() + STOP_PATIENCE;
        while self.child.try_wait()?.is_none() {
            tokio::select! {
                () = signals.child.next() => {}
                () = signals.stop.next() => return self.child.kill(),
                () = tokio::time::sleep_until(deadline) => return self.child.kill(),
            }
        }
        Ok(())
    }

    fn end(mut self) -> Result<Ended> {
        let status = self.child.wait().context("waiting for a program")?;
        let printed = self.printed.join().unwrap_or_else(|_| Ok(Vec::new()));
        Ok(Ended { status, printed: printed.context("reading from a program")? })
    }
}

/// Checks the exit status of a program, which has said why if it failed by itself.
///
/// # Errors
/// When the program has failed, with the exit code that its own stands for, or when a signal ended it.
pub(crate) fn expect_success(status: ExitStatus) -> Result<()> {
    if status.success() {
        return Ok(());
    }
    match status.code().and_then(|code| u8::try_from(code).ok()) {
        Some(code) => Err(Refusal::explained_by(code).into()),
        None => bail!(
            "expected that nothing ends a program of goalward, found one that ended by {status}"
        ),
    }
}

/// Checks that every program of [`Program::ALL`] exists.
///
/// # Errors
/// For the first program that is missing.
pub(crate) fn check_all() -> Result<()> {
    Program::ALL.iter().try_for_each(Program::check)
}

/// Returns how the user can call `goalward` again from the same folder.
pub(crate) fn own_command() -> String {
    let own = std::env::current_exe().unwrap_or_else(|_| PathBuf::from("goalward"));
    let current = std::env::current_dir().unwrap_or_default();
    quoted(callable_from(&current, &own).display())
}

/// Returns a program's path as a shell in the folder `current` takes it, relative if the program is inside that folder.
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
