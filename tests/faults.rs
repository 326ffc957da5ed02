//! Schedules of faults drawn at random: whoever is killed, held, slow or too many, or finds the disk full,
//! and whenever, the run ends with the weights of the undisturbed one, everything it recorded happened,
//! and nothing is left.
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
use system_tests::{
    Hashes, PATIENCE, SMALL, SMALL_PHYSICS, Signal, TestRun, Training, await_some, programs,
};

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
    /// The disk takes no byte of learner and service for some milliseconds.
    FillDisk(u64),
    /// The service gets a sixth of its time for some milliseconds.
    SlowService(u64),
}

/// Milliseconds to wait, and what happens then.
fn schedule(seed: u64) -> Vec<(u64, Fault)> {
    let mut stream = stream(seed, Purpose::TrainingEpisode, 0, 0);
    let fault = |stream: &mut Stream| match stream.random_range(0..12) {
        0..3 => Fault::Kill(stream.random_range(0..60)),
        3..5 => Fault::Hold(stream.random_range(0..60), stream.random_range(50..3_000)),
        5..7 => Fault::Scale(stream.random_range(1..5)),
        7 => Fault::Interrupt,
        8 => Fault::KillSupervisor,
        9 => Fault::FillDisk(stream.random_range(50..3_000)),
        10 => Fault::SlowService(stream.random_range(50..3_000)),
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

/// Lets no file of learner and service grow beyond so many bytes.
fn limit_writers(run: &TestRun, bytes: Option<u64>) {
    let writers = ["learner", "proximity-service"];
    for process in run.processes() {
        if writers.contains(&process.name.as_str()) {
            process.limit_files(bytes);
        }
    }
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
        Fault::FillDisk(milliseconds) => {
            limit_writers(run, Some(0));
            sleep(Duration::from_millis(milliseconds));
            limit_writers(run, None);
        }
        Fault::SlowService(milliseconds) => {
            let begun = Instant::now();
            while begun.elapsed() < Duration::from_millis(milliseconds) {
                let service =
                    run.processes().into_iter().find(|one| one.name == "proximity-service");
                let Some(service) = service else { break };
                service.signal(Signal::Stop);
                sleep(Duration::from_millis(25));
                service.signal(Signal::Continue);
                sleep(Duration::from_millis(5));
            }
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
fn a_disk_that_fills_up_pauses_the_run() {
    let run = TestRun::new(programs!());
    let mut training = start(&run, Task::Navigation);
    training.await_checkpoint(4);
    limit_writers(&run, Some(0));
    let said = || run.remarks().contains("no room on the disk").then_some(());
    await_some("a word of the full disk", PATIENCE, said);
    let checkpoint = run.folder().newest_checkpoint();
    sleep(Duration::from_secs(2));
    assert_eq!(run.folder().newest_checkpoint(), checkpoint, "expected the run to wait");
    limit_writers(&run, None);
    assert_eq!(training.finish().hashes(), undisturbed(Task::Navigation));
    assert!(!run.remarks().contains("ended"), "expected no process to die: {}", run.remarks());
}

#[test]
fn a_run_killed_at_its_very_end_leaves_nothing() {
    let run = TestRun::new(programs!());
    let training = start(&run, Task::Navigation);
    await_some("the summary", PATIENCE, || run.folder().summary_file().exists().then_some(()));
    strike(&run, &training, Fault::KillAll);
    training.end();
    assert_eq!(run.resume().end(), Some(0));
    assert_eq!(run.shared_memory(), Vec::<String>::new());
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
