//! The processes of a test, found in `/proc` by the program that they run, and signals to them.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use rustix::process::{Pid, Resource, Rlimit, getrlimit, prlimit};

use crate::{TestRun, await_some};

/// How long the system may take to deliver a signal.
const A_MOMENT: Duration = Duration::from_secs(10);

/// A signal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Signal {
    /// Ends a process at once.
    Kill,
    /// Interrupts a process, as Ctrl-C does.
    Interrupt,
    /// Asks a process to end.
    Terminate,
    /// Tells a process that its terminal has closed.
    Hangup,
    /// Stops a process until it is continued.
    Stop,
    /// Continues a stopped process.
    Continue,
}

/// A living process.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Process {
    /// Its process ID.
    pub id: u32,
    /// Its name in the run: learner, proximity-service, actor-0 and so on.
    pub name: String,
    arguments: Vec<String>,
}

impl Process {
    /// Sends it a signal.
    pub fn signal(&self, signal: Signal) {
        send(self.id, signal);
    }

    /// Returns the process IDs of its children that are still alive.
    pub fn children(&self) -> Vec<u32> {
        let parent = self.id.to_string();
        let is_child = |id: &u32| fields(*id).is_some_and(|fields| fields[1] == parent);
        numbers().filter(is_child).collect()
    }

    /// Limits the files that it writes to this many bytes, if it is still alive, which looks to it like a full disk.
    pub fn limit_files(&self, bytes: Option<u64>) {
        let limit = Rlimit { current: bytes, maximum: None };
        prlimit(Pid::from_raw(self.id as i32), Resource::Fsize, limit).ok();
    }

    /// Limits the files that it may open, or lifts the limit to what this process has.
    pub fn limit_open_files(&self, count: Option<u64>) {
        let own = getrlimit(Resource::Nofile);
        let limit = Rlimit { current: count.or(own.current), ..own };
        prlimit(Pid::from_raw(self.id as i32), Resource::Nofile, limit).expect("it is ours");
    }

    /// Whether it was started for the test's run, by a supervisor or by hand; `goalward` itself does not count.
    pub fn serves(&self, run: &TestRun) -> bool {
        let own = self.after("--run");
        self.name != "goalward" && own.is_some_and(|own| Path::new(own) == run.folder().path())
    }

    fn after(&self, flag: &str) -> Option<&str> {
        let at = self.arguments.iter().position(|argument| argument == flag)?;
        self.arguments.get(at + 1).map(String::as_str)
    }
}

/// Returns the live processes whose program is in `folder`.
pub(crate) fn living(folder: &Path) -> Vec<Process> {
    numbers().filter_map(|id| read(folder, id)).collect()
}

/// Returns the process IDs of all processes.
fn numbers() -> impl Iterator<Item = u32> {
    let entries = fs::read_dir("/proc").into_iter().flatten().flatten();
    entries.filter_map(|entry| entry.file_name().to_str()?.parse().ok())
}

/// Reads a process; `None` if it is gone, or its program is not in `folder`.
fn read(folder: &Path, id: u32) -> Option<Process> {
    let line = fs::read(format!("/proc/{id}/cmdline")).ok()?;
    let parts = line.split(|&byte| byte == 0).map(String::from_utf8_lossy);
    let arguments: Vec<String> = parts.map(|part| part.into_owned()).collect();
    let program = PathBuf::from(&arguments[0]);
    if program.parent() != Some(folder) {
        return None;
    }
    let mut process = Process { id, name: String::new(), arguments };
    let program = program.file_name()?.to_str()?;
    let own = program.strip_prefix("goalward-").unwrap_or(program);
    process.name = process.after("--name").unwrap_or(own).to_owned();
    Some(process)
}

/// Sends a signal to a process, which may be gone. After [`Signal::Stop`] it returns once the process has stopped.
pub fn send(id: u32, signal: Signal) {
    let number = match signal {
        Signal::Kill => rustix::process::Signal::KILL,
        Signal::Interrupt => rustix::process::Signal::INT,
        Signal::Terminate => rustix::process::Signal::TERM,
        Signal::Hangup => rustix::process::Signal::HUP,
        Signal::Stop => rustix::process::Signal::STOP,
        Signal::Continue => rustix::process::Signal::CONT,
    };
    let process = Pid::from_raw(id.try_into().expect("a process ID")).expect("not 0");
    rustix::process::kill_process(process, number).ok();
    if signal == Signal::Stop {
        await_some("a held process", A_MOMENT, || stands_still(id).then_some(()));
    }
}

/// Whether a process is stopped or gone.
fn stands_still(id: u32) -> bool {
    fields(id).is_none_or(|fields| ["T", "Z", "X"].contains(&fields[0].as_str()))
}

/// Returns the fields of a process's `stat` after its name, which ends with the last bracket: state, parent and so
/// on; `None` if it is gone.
fn fields(id: u32) -> Option<Vec<String>> {
    let stat = fs::read_to_string(format!("/proc/{id}/stat")).ok()?;
    let (_, rest) = stat.rsplit_once(") ")?;
    Some(rest.split_whitespace().map(str::to_owned).collect())
}
