//! Schedules of faults drawn at random: whoever is killed, held or too many, and whenever, the run ends
//! with the weights of the undisturbed one, everything it recorded happened, and nothing is left.
//!
//! Method: a schedule is drawn from a number and played against a short run of the real programs; the
//! tasks take turns. The number is the bug report: `deploy/soak.sh --seed N` plays its schedule again
//! (the moments differ a little, as processes take their own time). What ends the supervisor is
//! followed by `--resume`, as its user would.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::collections::BTreeMap;
use std::env;
use std::io::Write;
use std::thread::sleep;
use std::time::{Duration, Instant};

use protocol::seed::{Purpose, Stream, stream};
use protocol::task::Task;
use rand::RngExt;
use system_tests::{Hashes, SMALL, SMALL_PHYSICS, Signal, TestRun, Training, programs};

const TASKS: [Task; 4] = [Task::Navigation, Task::FetchPick, Task::FetchPush, Task::AntReach];

/// Schedules of the quick form: each task twice.
const QUICK: std::ops::Range<u64> = 0..8;

/// Times a run may be resumed; a schedule has fewer faults.
const MOST_RESUMES: usize = 12;

/// What happens to a run.
#[derive(Clone, Copy, Debug)]
enum Fault {
    /// One of its processes, whichever this number falls on, is killed.
    Kill(usize),
    /// One of its processes is held for some milliseconds.
    Hold(usize, u64),
    /// It gets so many actors.
    Scale(u64),
    /// The user presses Ctrl-C.
    Interrupt,
    /// The supervisor is killed.
    KillSupervisor,
    /// The machine loses power: everything is killed.
    KillAll,
}

/// Milliseconds to wait, and what happens then.
fn schedule(seed: u64) -> Vec<(u64, Fault)> {
    let mut stream = stream(seed, Purpose::TrainingEpisode, 0, 0);
    let fault = |stream: &mut Stream| match stream.random_range(0..10) {
        0..3 => Fault::Kill(stream.random_range(0..60)),
        3..5 => Fault::Hold(stream.random_range(0..60), stream.random_range(50..3_000)),
        5..7 => Fault::Scale(stream.random_range(1..5)),
        7 => Fault::Interrupt,
        8 => Fault::KillSupervisor,
        _ => Fault::KillAll,
    };
    let count = stream.random_range(2..6);
    (0..count).map(|_| (stream.random_range(20..1_500), fault(&mut stream))).collect()
}

fn start(run: &TestRun, task: Task) -> Training<'_> {
    let (small, settings) = match task {
        Task::Navigation => (&SMALL[..], ["steps=16000", "resources.lease_timeout_ms=1000"]),
        _ => (&SMALL_PHYSICS[..], ["steps=6400", "resources.lease_timeout_ms=1000"]),
    };
    run.train_task(task.name(), small, &settings)
}

fn undisturbed(task: Task) -> Hashes {
    let run = TestRun::new(programs!());
    start(&run, task).finish().hashes()
}

/// Lets a fault happen.
fn strike(run: &TestRun, training: &Training<'_>, fault: Fault) {
    let chosen = |number: usize| {
        let mut processes = run.processes();
        processes.sort_by(|one, other| one.name.cmp(&other.name));
        let count = processes.len().max(1);
        processes.into_iter().nth(number % count)
    };
    match fault {
        Fault::Kill(number) => {
            if let Some(process) = chosen(number) {
                process.signal(Signal::Kill);
            }
        }
        Fault::Hold(number, milliseconds) => {
            if let Some(process) = chosen(number) {
                process.signal(Signal::Stop);
                sleep(Duration::from_millis(milliseconds));
                process.signal(Signal::Continue);
            }
        }
        Fault::Scale(actors) => {
            let mut scale = run.program("goalward");
            scale.arg("scale").arg(run.folder().path()).args(["--actors", &actors.to_string()]);
            // Refused when the run is over or its supervisor has just been killed.
            scale.output().unwrap();
        }
        Fault::Interrupt => training.signal(Signal::Interrupt),
        Fault::KillSupervisor => training.signal(Signal::Kill),
        Fault::KillAll => {
            training.signal(Signal::Kill);
            for process in run.processes() {
                process.signal(Signal::Kill);
            }
        }
    }
}

/// Plays a schedule; the run must end as the undisturbed one.
fn play(seed: u64, expected: &mut BTreeMap<&'static str, Hashes>) {
    let task = TASKS[seed as usize % TASKS.len()];
    let expected = expected.entry(task.name()).or_insert_with(|| undisturbed(task));
    let schedule = schedule(seed);
    let shown = format!("schedule {seed}, {task}: {schedule:?}");
    let run = TestRun::new(programs!());
    let mut training = start(&run, task);
    let mut resumes = 0;
    for (milliseconds, fault) in &schedule {
        sleep(Duration::from_millis(*milliseconds));
        if run.folder().summary_file().exists() {
            break;
        }
        // Before the folder has a configuration there is no run to resume.
        if training.has_ended() && run.folder().config_file().exists() {
            training = run.resume();
            resumes += 1;
        }
        strike(&run, &training, *fault);
    }
    while training.end() != Some(0) || !run.folder().summary_file().exists() {
        assert!(resumes < MOST_RESUMES, "{shown}: resumed too often");
        resumes += 1;
        training =
            if run.folder().config_file().exists() { run.resume() } else { start(&run, task) };
    }
    let summary = run.summary();
    assert_eq!(summary.hashes(), *expected, "{shown}");
    let mut verify = run.program("goalward");
    let verified = verify.arg("replay").arg(run.folder().path()).arg("--verify").output().unwrap();
    let stderr = String::from_utf8_lossy(&verified.stderr);
    assert!(verified.status.success(), "{shown}: {stderr}");
    assert_eq!(run.shared_memory(), Vec::<String>::new(), "{shown}");
}

#[test]
fn random_faults_change_nothing() {
    let mut expected = BTreeMap::new();
    QUICK.for_each(|seed| play(seed, &mut expected));
}

/// `deploy/soak.sh` calls this with the minutes and the first number in the environment.
#[test]
#[ignore = "as long as deploy/soak.sh says"]
fn soak() {
    let number = |name: &str| env::var(name).ok().and_then(|text| text.parse().ok());
    let minutes = number("GOALWARD_SOAK_MINUTES").unwrap_or(10);
    let first = number("GOALWARD_SOAK_SEED").unwrap_or(100);
    let begun = Instant::now();
    let mut expected = BTreeMap::new();
    let mut played = 0;
    while played == 0 || begun.elapsed() < Duration::from_secs(60 * minutes) {
        play(first + played, &mut expected);
        played += 1;
        let last = first + played - 1;
        writeln!(std::io::stdout(), "schedules {first} to {last}: nothing changed").unwrap();
    }
}
