//! The Python process that holds an actor's environments: its start, its turns and its end.

use std::collections::BTreeMap;
use std::io::{self, ErrorKind};
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use environments::EnvironmentError;
use protocol::dropped::shortened;

use crate::frame::{self, Answer, Failure, Hello, Kind, Request};

/// The source text of the process.
const CHILD: &str = include_str!("child.py");

/// The source text of the module that converts observations and actions.
const SPACES: &str = include_str!("spaces.py");

/// Environment variable that names the interpreter.
const INTERPRETER: &str = "GOALWARD_PYTHON";

/// How long an answer may take, for example the reset of a large scene or the import of many packages.
const PATIENCE: Duration = Duration::from_secs(120);

/// Longest text of an exception in an error, characters.
const ERROR_CHARS: usize = 1000;

/// How long a process that has closed its end of the link may take to exit.
const FAREWELL: Duration = Duration::from_secs(5);

/// How long a process may take to close its environments.
const CLOSING: Duration = Duration::from_secs(3);

/// Makes all processes give the same results. Strings get the same hashes, so that sets of strings have the
/// same order. The fused multiply-add variants of the system's mathematics library are switched off, because
/// not every processor has them.
const SAME_EVERYWHERE: [(&str, &str); 2] =
    [("PYTHONHASHSEED", "0"), ("GLIBC_TUNABLES", "glibc.cpu.hwcaps=-FMA,-FMA4")];

/// A Python process, and the requests to its slots.
pub(super) struct Link {
    python: Python,
    hello: Hello,
    /// Slots that nobody holds.
    free: Vec<u16>,
    slots: u16,
    /// Requests that have not been sent.
    pending: Vec<u8>,
    announced: Vec<u16>,
    answers: BTreeMap<u16, Answer>,
}

/// A Python process and the actor's end of the link.
struct Python {
    child: Child,
    stream: UnixStream,
    /// The slot whose environment has failed, and its message; the process ends with it.
    raised: Option<(u16, String)>,
    /// Whether it has failed, or is gone.
    has_ended: bool,
}

impl Link {
    /// Starts a process with these options, in JSON, and waits until it describes the environment. The process
    /// is killed if it does not answer within [`PATIENCE`].
    ///
    /// # Errors
    /// When there is no such interpreter, or the environment cannot be made.
    pub(super) fn start(options: &str) -> Result<Link, EnvironmentError> {
        let mut python = Python::start(options)?;
        let hello = serde_json::from_slice(&python.receive(Kind::Hello)?)
            .map_err(|error| EnvironmentError::Other(format!("hello of Python: {error}")))?;
        Ok(Link {
            python,
            hello,
            free: Vec::new(),
            slots: 0,
            pending: Vec::new(),
            announced: Vec::new(),
            answers: BTreeMap::new(),
        })
    }

    /// Returns the description of the environment.
    pub(super) fn hello(&self) -> &Hello {
        &self.hello
    }

    /// Returns whether the process has failed or is gone.
    pub(super) fn has_ended(&self) -> bool {
        self.python.has_ended
    }

    /// Takes a slot that nobody holds.
    pub(super) fn take_slot(&mut self) -> u16 {
        self.free.pop().unwrap_or_else(|| {
            self.slots += 1;
            self.slots - 1
        })
    }

    /// Gives a slot back. Its environment stays for the next holder, who must not receive an answer to this one.
    pub(super) fn give_back(&mut self, slot: u16) {
        if self.announced.contains(&slot) && self.turn().is_err() {
            // The next request reports the error.
            return;
        }
        self.answers.remove(&slot);
        self.free.push(slot);
    }

    /// Notes a slot's request for the next turn.
    pub(super) fn announce(&mut self, slot: u16, request: Request<'_>) {
        frame::append(slot, request, self.hello.action.bytes(), &mut self.pending);
        self.announced.push(slot);
    }

    /// Returns whether a slot has been announced or already has its answer.
    pub(super) fn is_announced(&self, slot: u16) -> bool {
        self.announced.contains(&slot) || self.answers.contains_key(&slot)
    }

    /// Returns a slot's answer; takes a turn if the slot has not had it yet.
    ///
    /// # Errors
    /// When the environment has failed, or the process is gone or silent. If another environment of the process
    /// raised the error, this is [`EnvironmentError::Other`].
    pub(super) fn answer(&mut self, slot: u16) -> Result<Answer, EnvironmentError> {
        if !self.answers.contains_key(&slot) {
            self.turn().map_err(|error| match (&self.python.raised, error) {
                (Some((raised, _)), EnvironmentError::Raised(words)) if *raised != slot => {
                    EnvironmentError::Other(format!(
                        "in the same process as an environment that failed: {words}"
                    ))
                }
                (_, error) => error,
            })?;
        }
        let answer = self.answers.remove(&slot);
        answer.ok_or_else(|| EnvironmentError::Other(format!("slot {slot}: no answer of Python")))
    }

    /// Returns the action that the expert of a slot takes.
    ///
    /// # Errors
    /// As [`Link::answer`].
    pub(super) fn expert_action(&mut self, slot: u16) -> Result<Vec<u8>, EnvironmentError> {
        // If the process is gone, the read that follows reports it.
        frame::write(&mut self.python.stream, Kind::Expert, &slot.to_le_bytes()).ok();
        self.python.receive(Kind::Expert)
    }

    /// Returns a picture of a slot's state as a PNG file; empty if the environment renders none.
    ///
    /// # Errors
    /// As [`Link::answer`].
    pub(super) fn picture(&mut self, slot: u16) -> Result<Vec<u8>, EnvironmentError> {
        frame::write(&mut self.python.stream, Kind::Picture, &slot.to_le_bytes()).ok();
        self.python.receive(Kind::Picture)
    }

    fn turn(&mut self) -> Result<(), EnvironmentError> {
        if let Some((_, words)) = &self.python.raised {
            return Err(EnvironmentError::Raised(words.clone()));
        }
        let body = std::mem::take(&mut self.pending);
        self.announced.clear();
        if frame::write(&mut self.python.stream, Kind::Turn, &body).is_err() {
            // The process said why before it closed its end, or it was killed.
            return self.python.receive(Kind::Turn).map(drop);
        }
        let body = self.python.receive(Kind::Turn)?;
        self.answers.extend(frame::answers(&body, self.hello.observation.bytes()));
        Ok(())
    }
}

impl Python {
    fn start(options: &str) -> Result<Python, EnvironmentError> {
        let interpreter = std::env::var(INTERPRETER).unwrap_or_else(|_| "python3".to_owned());
        let (stream, other) = UnixStream::pair().map_err(other_error)?;
        stream.set_read_timeout(Some(PATIENCE)).map_err(other_error)?;
        // Standard output is reserved for the actor itself.
        let mut command = Command::new(&interpreter);
        command
            .args(["-c", CHILD, SPACES, options])
            .envs(SAME_EVERYWHERE)
            .stdin(Stdio::from(OwnedFd::from(other)))
            .stdout(Stdio::null());
        let child = spawned(command).map_err(|error| {
            EnvironmentError::Other(format!(
                "expected Python as {interpreter}, or where {INTERPRETER} says, found: {error}"
            ))
        })?;
        Ok(Python { child, stream, raised: None, has_ended: false })
    }

    fn receive(&mut self, expected: Kind) -> Result<Vec<u8>, EnvironmentError> {
        let read = frame::read(&mut self.stream);
        self.has_ended = !matches!(&read, Ok((kind, _)) if *kind == expected);
        match read {
            Ok((kind, body)) if kind == expected => Ok(body),
            Ok((Kind::Failed, body)) => Err(self.failed(&body)),
            Ok((kind, _)) => Err(EnvironmentError::Other(format!(
                "expected a frame of kind {expected:?} of Python, found {kind:?}"
            ))),
            Err(error) => Err(EnvironmentError::Other(self.gone(&error))),
        }
    }

    /// Returns why an environment failed; logs the traceback unless it failed at the start.
    fn failed(&mut self, body: &[u8]) -> EnvironmentError {
        let Failure { slot, during, error, traceback } = match serde_json::from_slice(body) {
            Ok(failure) => failure,
            Err(error) => {
                let words = format!("Python failed and could not say why: {error}");
                return EnvironmentError::Other(words);
            }
        };
        if during != "start" {
            tracing::error!("{}", traceback.trim_end());
        }
        // Texts of exceptions may have any number of lines.
        let error = error.split_whitespace().collect::<Vec<_>>().join(" ");
        let words = format!("{during} in Python: {}", shortened(&error, ERROR_CHARS));
        self.raised = Some((slot, words.clone()));
        EnvironmentError::Raised(words)
    }

    /// Returns why nothing arrives any more; kills the process if it has not answered in time.
    fn gone(&mut self, error: &io::Error) -> String {
        if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) {
            self.child.kill().ok();
            let patience = self.stream.read_timeout().ok().flatten().unwrap_or_default();
            let seconds = patience.as_secs_f64();
            return format!("Python has not answered for {seconds} s and was killed");
        }
        match self.ended_within(FAREWELL) {
            Some(status) => format!("Python ended ({status}) without a word"),
            None => format!("Python has closed its end: {error}"),
        }
    }

    /// Waits for the process to end and returns how it ended; `None` if it is still running after `patience`.
    fn ended_within(&mut self, patience: Duration) -> Option<ExitStatus> {
        let deadline = Instant::now() + patience;
        loop {
            if let Ok(Some(status)) = self.child.try_wait() {
                return Some(status);
            }
            if Instant::now() >= deadline {
                return None;
            }
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}

/// Starts a process. The process asks to be killed when the thread that started it ends, so one thread that
/// never ends starts all of them.
fn spawned(command: Command) -> io::Result<Child> {
    type Order = (Command, SyncSender<io::Result<Child>>);
    static STARTER: Mutex<Option<SyncSender<Order>>> = Mutex::new(None);
    let mut starter = STARTER.lock().unwrap_or_else(PoisonError::into_inner);
    if starter.is_none() {
        let (sender, orders) = sync_channel::<Order>(1);
        let start = |(mut command, child): Order| drop(child.send(command.spawn()));
        let named = std::thread::Builder::new().name("python-starter".to_owned());
        named.spawn(move || orders.into_iter().for_each(start))?;
        *starter = Some(sender);
    }
    let (sender, child) = sync_channel(1);
    let sent = starter.as_ref().is_some_and(|starter| starter.send((command, sender)).is_ok());
    if !sent {
        return Err(io::Error::other("the thread that starts processes is gone"));
    }
    child.recv().map_err(io::Error::other)?
}

impl Drop for Python {
    fn drop(&mut self) {
        // Closing the link makes the process close its environments and end; one that hangs is killed.
        self.stream.shutdown(std::net::Shutdown::Both).ok();
        if self.ended_within(CLOSING).is_none() {
            self.child.kill().ok();
            self.child.wait().ok();
        }
    }
}

fn other_error(error: io::Error) -> EnvironmentError {
    EnvironmentError::Other(format!("the link to Python: {error}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn has_python() -> bool {
        let named = std::env::var(INTERPRETER).ok().filter(|python| !python.is_empty());
        named.expect("GOALWARD_PYTHON: expected an interpreter, or `none`; deploy/test.sh sets it")
            != "none"
    }

    #[test]
    fn a_process_outlives_the_thread_that_asked_for_it() {
        if !has_python() {
            return;
        }
        let options = r#"{"environment": "python:tests.python_environments:line", "kwargs": {},
            "success": "none", "expert": "", "render": false}"#;
        let start = || Link::start(options).unwrap();
        let mut link = std::thread::scope(|scope| scope.spawn(start).join()).unwrap();
        std::thread::sleep(Duration::from_millis(100));
        let slot = link.take_slot();
        link.announce(slot, Request::Reset { seed: 1, rebuild: false });
        link.answer(slot).unwrap();
    }

    #[test]
    fn a_process_that_hangs_is_killed() {
        if !has_python() {
            return;
        }
        let options = r#"{"environment": "python:tests.python_environments:bad",
            "kwargs": {"how": "hangs"}, "success": "none", "expert": "", "render": false}"#;
        let mut link = Link::start(options).unwrap();
        link.python.stream.set_read_timeout(Some(Duration::from_secs(1))).unwrap();
        let slot = link.take_slot();
        link.announce(slot, Request::Reset { seed: 1, rebuild: false });
        link.answer(slot).unwrap();
        let action = 0.0_f32.to_le_bytes();
        let said = loop {
            link.announce(slot, Request::Step(&action));
            if let Err(said) = link.answer(slot) {
                break said.to_string();
            }
        };
        assert!(said.contains("not answered for 1 s and was killed"), "{said}");
        assert!(link.python.child.wait().unwrap().code().is_none(), "it ended by a signal");
    }
}
