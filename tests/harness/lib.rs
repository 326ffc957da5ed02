//! The harness of the system tests: a run of the real programs in a folder of its own.
//!
//! Method: the programs are the shipped `main.rs` of every process. Cargo builds them as binaries of this package,
//! and they are linked into the test's folder under their usual names, because `goalward` looks for the other
//! programs beside itself. Nothing runs in-process and nothing is mocked. Only its configuration makes a run small
//! ([`SMALL`]). When a [`TestRun`] is dropped, its processes are killed by their IDs and its shared memory is
//! removed. If the test failed, its folder is kept and its path printed.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

mod namespace;
mod page;
mod process;
mod relay;
mod summary;

use std::ffi::OsStr;
use std::fs::{self, File, OpenOptions};
use std::io::Write;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use bus::BusAddress;
use protocol::setting::Setting;
use protocol::task::Spec;
use run::folder::RunFolder;

pub use namespace::Namespace;
pub use page::Page;
pub use process::{Process, Signal, send};
pub use relay::Relay;
pub use summary::{Evaluation, Hashes, Log, Summary};

/// The tasks that come with the programs.
pub const TASKS: [&str; 4] = ["navigation", "fetch-pick", "fetch-push", "ant-reach"];

/// The interpreter for tests of Python; `None` if `GOALWARD_PYTHON=none` skips them.
///
/// # Panics
/// If `GOALWARD_PYTHON` is not set, so that nobody skips them unawares.
pub fn python() -> Option<String> {
    let named = std::env::var("GOALWARD_PYTHON").ok().filter(|python| !python.is_empty());
    let python = named.expect(
        "GOALWARD_PYTHON: expected an interpreter that has tests/requirements.txt, or `none`, which \
         leaves tests of Python out; deploy/test.sh sets it",
    );
    (python != "none").then_some(python)
}

/// The shapes of a built-in task.
pub fn spec(task: &str) -> Spec {
    environments::create(task, &Setting::default()).unwrap().spec()
}

/// Iterations of a run with [`SMALL`].
pub const ITERATIONS: u64 = 20;

/// Lanes of a run with [`SMALL`].
pub const LANES: u64 = 4;

/// Iterations between two checkpoints of a run with [`SMALL`].
pub const CHECKPOINT_ITERATIONS: u64 = 4;

/// Settings with which a run takes seconds and still has every part of a long one.
pub const SMALL: [&str; 18] = [
    "steps=8000",
    "rollout.lanes=4",
    "rollout.lane_steps=100",
    "policy.convolution_channels=[4, 8, 8]",
    "policy.features=16",
    "ppo.minibatches=2",
    "ppo.epochs=1",
    "reward.convolution_channels=[4, 8, 8]",
    "reward.features=16",
    "reward.hidden=[16, 16]",
    "reward.samples=64",
    "reward.ensemble=2",
    "reward.pretraining_epochs=1",
    "demonstrations.episodes=40",
    "evaluation.episodes=8",
    "checkpoint.iterations=4",
    "checkpoint.keep=10",
    "resources.actors=2",
];

/// The counterpart of [`SMALL`] for the physics tasks, with 8 iterations.
const SMALL_PHYSICS: [&str; 16] = [
    "steps=3200",
    "rollout.lanes=4",
    "rollout.lane_steps=100",
    "policy.hidden=[16, 16]",
    "ppo.minibatches=2",
    "ppo.epochs=1",
    "reward.hidden=[16, 16]",
    "reward.batch=32",
    "reward.samples=64",
    "reward.experience=500",
    "reward.ensemble=2",
    "demonstrations.episodes=10",
    "evaluation.episodes=4",
    "checkpoint.iterations=2",
    "checkpoint.keep=10",
    "resources.actors=2",
];

/// Returns the settings that make a run of a task small.
pub fn small(task: &str) -> &'static [&'static str] {
    if task == "navigation" { &SMALL } else { &SMALL_PHYSICS }
}

/// Keeps the settings that a method reads, because others are refused.
pub fn read_by<'a>(method: &str, small: &[&'a str]) -> Vec<&'a str> {
    let unread: &[&str] = match method {
        "bc" => &["ppo.", "reward.", "rollout.lane_steps"],
        "bco" | "sqil" => &["ppo.", "reward."],
        "environment-reward" | "nearest-state" | "segment-matching" => &["reward."],
        "gail" | "gaifo" | "gaifo-s" | "gaifo-s-uncertainty" | "gaifo-next-state" => {
            &["reward.pretraining_epochs"]
        }
        "temporal-distance" => &["reward.samples", "reward.experience"],
        _ => &[],
    };
    let is_read = |setting: &&str| !unread.iter().any(|start| setting.starts_with(start));
    small.iter().copied().filter(is_read).collect()
}

/// Longer than anything that a test waits for takes on the slowest machine.
pub const PATIENCE: Duration = Duration::from_secs(240);

/// Interval at which awaited conditions are polled.
const LOOK_EVERY: Duration = Duration::from_millis(5);

/// Paths of the programs that cargo has built; made by [`programs!`].
#[derive(Clone, Copy, Debug)]
pub struct Programs {
    /// Each program's usual name, and its file.
    pub files: [(&'static str, &'static str); 5],
    /// A folder for tests, on the same file system as the programs.
    pub scratch: &'static str,
}

/// Returns the programs under test. A macro, because only a test knows where cargo has put them.
#[macro_export]
macro_rules! programs {
    () => {
        $crate::Programs {
            files: [
                ("goalward", env!("CARGO_BIN_EXE_goalward-under-test")),
                ("goalward-actor", env!("CARGO_BIN_EXE_actor-under-test")),
                ("goalward-learner", env!("CARGO_BIN_EXE_learner-under-test")),
                ("goalward-proximity-service", env!("CARGO_BIN_EXE_proximity-service-under-test")),
                ("goalward-gateway", env!("CARGO_BIN_EXE_gateway-under-test")),
            ],
            scratch: env!("CARGO_TARGET_TMPDIR"),
        }
    };
}

/// A folder with the programs and at most one run.
#[derive(Debug)]
pub struct TestRun {
    home: PathBuf,
}

impl TestRun {
    /// Creates the folder; it has no run yet.
    pub fn new(programs: Programs) -> TestRun {
        fs::create_dir_all(programs.scratch).unwrap();
        let home = tempfile::Builder::new().prefix("run-").tempdir_in(programs.scratch).unwrap();
        let home = home.keep().canonicalize().unwrap();
        fs::create_dir(home.join("bin")).unwrap();
        for (name, file) in programs.files {
            fs::hard_link(file, home.join("bin").join(name)).unwrap();
        }
        TestRun { home }
    }

    /// Returns a path in the test's folder.
    pub fn path(&self, name: &str) -> PathBuf {
        self.home.join(name)
    }

    /// Returns the run's folder, which need not exist.
    pub fn folder(&self) -> RunFolder {
        RunFolder::new(self.path("run"))
    }

    /// Returns a command that starts one of the programs in the test's folder.
    pub fn program(&self, name: &str) -> Command {
        self.command(self.path("bin").join(name))
    }

    fn command(&self, program: impl AsRef<OsStr>) -> Command {
        let mut command = Command::new(program);
        command.current_dir(&self.home).stdin(Stdio::null()).env_remove("RUST_LOG");
        command
    }

    /// Starts `goalward train navigation` on a new run with [`SMALL`] and then `settings`.
    pub fn train(&self, settings: &[&str]) -> Training<'_> {
        self.train_task("navigation", settings)
    }

    /// Runs `goalward` to its end; returns whether it succeeded, and what it printed on both outputs.
    pub fn goalward(&self, arguments: &[&str]) -> (bool, String) {
        let output = self.program("goalward").args(arguments).output().expect("goalward is there");
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        (output.status.success(), text(&output.stdout) + &text(&output.stderr))
    }

    /// Starts `goalward train` on a new run of a task with `settings`, after those of [`small`] that its method reads.
    /// If the demonstrations are given, none of these are about them.
    pub fn train_task(&self, task: &str, settings: &[&str]) -> Training<'_> {
        let mut command = self.program("goalward");
        command.args(["train", task, "--no-page"]);
        let method = settings.iter().find_map(|setting| setting.strip_prefix("method="));
        let are_given = settings.iter().any(|setting| setting.starts_with("demonstrations.file="));
        let mut small = read_by(method.unwrap_or("goal-proximity"), small(task));
        small.retain(|setting| !(are_given && setting.starts_with("demonstrations.")));
        for setting in small.iter().chain(settings) {
            command.args(["--set", setting]);
        }
        self.start(command)
    }

    /// Starts `goalward train navigation` on a new run that accepts actors of other machines.
    pub fn train_listening(&self, address: &str, audit: f64, settings: &[&str]) -> Training<'_> {
        let mut command = self.program("goalward");
        command.args(["train", "navigation", "--no-page", "--listen", address]);
        command.arg(format!("--audit={audit}"));
        for setting in SMALL.iter().chain(settings) {
            command.args(["--set", setting]);
        }
        self.start(command)
    }

    /// Starts `goalward train --resume` on the run.
    pub fn resume(&self) -> Training<'_> {
        self.resume_with(&[])
    }

    /// Starts `goalward train --resume` on the run, with further arguments.
    pub fn resume_with(&self, arguments: &[&str]) -> Training<'_> {
        let mut command = self.program("goalward");
        command.args(["train", "--resume", "--no-page"]).args(arguments);
        self.start(command)
    }

    /// Trains a new run to its end.
    pub fn finish(&self, settings: &[&str]) -> Summary {
        self.train(settings).finish()
    }

    fn start(&self, goalward: Command) -> Training<'_> {
        // With SIGXFSZ ignored, writing beyond the limit of `Process::limit_files` is an error, not a death.
        let mut command = self.command("sh");
        command.args(["-c", "trap '' XFSZ; exec \"$@\"", "sh"]);
        command.arg(goalward.get_program()).args(goalward.get_args());
        command.arg("--run").arg(self.folder().path());
        command.stdout(self.output("goalward.out")).stderr(self.output("goalward.err"));
        Training { run: self, supervisor: command.spawn().unwrap() }
    }

    fn output(&self, name: &str) -> File {
        OpenOptions::new().create(true).append(true).open(self.path(name)).unwrap()
    }

    /// What `goalward` has printed on standard error so far.
    pub fn remarks(&self) -> String {
        fs::read_to_string(self.path("goalward.err")).unwrap_or_default()
    }

    /// Reads the summary of the finished run.
    pub fn summary(&self) -> Summary {
        let file = self.folder().summary_file();
        let text = fs::read_to_string(&file)
            .unwrap_or_else(|error| panic!("{}: {error}\n{}", file.display(), self.words()));
        serde_json::from_str(&text).unwrap()
    }

    /// The live processes of the run, without the supervisor.
    pub fn processes(&self) -> Vec<Process> {
        let mut processes = self.all_processes();
        processes.retain(|process| process.serves(self));
        processes
    }

    /// All live processes of the test's programs, including supervisors and those of other runs.
    pub fn all_processes(&self) -> Vec<Process> {
        process::living(&self.path("bin"))
    }

    /// Waits for the live process of the run with this name: learner, proximity-service, actor-0 and so on.
    pub fn process(&self, name: &str) -> Process {
        let found = || self.processes().into_iter().find(|process| process.name == name);
        await_some(&format!("process {name}"), PATIENCE, found)
    }

    /// Folders of the hosts that have joined a run from the test's folder.
    pub fn joined_folders(&self) -> Vec<PathBuf> {
        let entries = fs::read_dir(&self.home).into_iter().flatten().flatten();
        let is_one = |name: &OsStr| name.as_encoded_bytes().starts_with(b"goalward-join-");
        entries.filter(|entry| is_one(&entry.file_name())).map(|entry| entry.path()).collect()
    }

    /// Names of the run's objects in shared memory, and the path of its bus folder if it exists.
    pub fn shared_memory(&self) -> Vec<String> {
        let Some(address) = BusAddress::if_started(self.folder().path()).unwrap() else {
            return Vec::new();
        };
        let entries = fs::read_dir("/dev/shm").into_iter().flatten().flatten();
        let names = entries.map(|entry| entry.file_name().to_string_lossy().into_owned());
        let objects = names.filter(|name| name.starts_with(address.prefix()));
        let root = Some(address.root()).filter(|root| root.exists());
        objects.chain(root.map(|root| root.display().to_string())).collect()
    }

    /// Reads every file of the test's folder except the programs, to check that nothing was changed.
    pub fn contents(&self) -> Vec<(PathBuf, Vec<u8>)> {
        let mut files = Vec::new();
        let mut folders = vec![self.home.clone()];
        while let Some(folder) = folders.pop() {
            for entry in fs::read_dir(&folder).unwrap() {
                let path = entry.unwrap().path();
                if !path.is_dir() {
                    let bytes = fs::read(&path).unwrap();
                    files.push((path, bytes));
                } else if path != self.path("bin") {
                    folders.push(path);
                }
            }
        }
        files.sort();
        files
    }

    /// The last lines of everything that the run has printed.
    fn words(&self) -> String {
        let outputs = fs::read_dir(self.folder().output()).into_iter().flatten().flatten();
        let files = [self.path("goalward.out"), self.path("goalward.err")];
        let mut words = String::new();
        for file in files.into_iter().chain(outputs.map(|entry| entry.path())) {
            let text = fs::read_to_string(&file).unwrap_or_default();
            let lines: Vec<_> = text.lines().collect();
            let last = &lines[lines.len().saturating_sub(12)..];
            words += &format!("--- {}\n{}\n", file.display(), last.join("\n"));
        }
        words
    }
}

impl Drop for TestRun {
    fn drop(&mut self) {
        for process in process::living(&self.path("bin")) {
            process.signal(Signal::Kill);
        }
        for folder in self.joined_folders().into_iter().chain([self.path("run")]) {
            let Ok(Some(address)) = BusAddress::if_started(&folder) else { continue };
            let removed = || address.remove().is_ok();
            let deadline = Instant::now() + Duration::from_secs(5);
            while !removed() && Instant::now() < deadline {
                std::thread::sleep(LOOK_EVERY);
            }
        }
        if std::thread::panicking() {
            let home = self.home.display();
            writeln!(std::io::stderr(), "the files of the failed test are in {home}").ok();
        } else {
            fs::remove_dir_all(&self.home).ok();
        }
    }
}

/// A `goalward train` process that has been started.
#[derive(Debug)]
pub struct Training<'a> {
    run: &'a TestRun,
    supervisor: Child,
}

impl Training<'_> {
    /// Waits until the checkpoint after `iteration` iterations exists. The run must not have ended by then, so that
    /// what the test does next happens in the middle of the run.
    pub fn await_checkpoint(&mut self, iteration: u64) {
        let folder = self.run.folder().checkpoint_folder(iteration);
        let deadline = Instant::now() + PATIENCE;
        while !folder.exists() {
            let what = format!("checkpoint {iteration}");
            self.expect_going_on(&what);
            assert!(Instant::now() < deadline, "{what} did not come\n{}", self.run.words());
            std::thread::sleep(LOOK_EVERY);
        }
        self.expect_going_on("a moment in the middle of the run");
    }

    /// Fails if the run has ended before `what`.
    pub fn expect_going_on(&mut self, what: &str) {
        let ended = self.supervisor.try_wait().unwrap();
        let is_over = ended.is_some() || self.run.folder().summary_file().exists();
        assert!(!is_over, "the run ended ({ended:?}) before {what}\n{}", self.run.words());
    }

    /// Whether the supervisor has ended.
    pub fn has_ended(&mut self) -> bool {
        self.supervisor.try_wait().unwrap().is_some()
    }

    /// Sends a signal to the supervisor.
    pub fn signal(&self, signal: Signal) {
        process::send(self.supervisor.id(), signal);
    }

    /// Waits for the supervisor to end; returns its exit code, or `None` if a signal ended it.
    pub fn end(mut self) -> Option<i32> {
        let deadline = Instant::now() + PATIENCE;
        loop {
            if let Some(status) = self.supervisor.try_wait().unwrap() {
                return status.code();
            }
            assert!(Instant::now() < deadline, "the run did not end\n{}", self.run.words());
            std::thread::sleep(LOOK_EVERY);
        }
    }

    /// Waits for the end of a run that must finish; returns its summary.
    pub fn finish(self) -> Summary {
        let run = self.run;
        let code = self.end();
        assert_eq!(code, Some(0), "the run failed\n{}", run.words());
        run.summary()
    }
}

/// Polls `look` until it returns something; after `patience` it fails and names what was expected.
pub fn await_some<T>(what: &str, patience: Duration, mut look: impl FnMut() -> Option<T>) -> T {
    let deadline = Instant::now() + patience;
    loop {
        if let Some(found) = look() {
            return found;
        }
        assert!(Instant::now() < deadline, "expected {what} within {patience:?}");
        std::thread::sleep(LOOK_EVERY);
    }
}
