//! Random fault schedules: processes are killed, stopped, slowed down, added or removed, the disk is full, checkpoints
//! are damaged. Whatever happens, and whenever, the run ends with the weights of the undisturbed one, its episodes can
//! be verified, and nothing is left behind.
//!
//! Method: a schedule is drawn from a seed and played against a short run of the real programs; tasks and lags 0 and 1
//! alternate. The seed is the bug report: `deploy/soak.sh --seed N` plays its schedule again, though the moments
//! differ a little, because the timing of processes varies. After a fault that ends the supervisor, the run is
//! resumed with `--resume`, as its user would do.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::io::Write;
use std::panic::catch_unwind;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, OnceLock};
use std::thread::sleep;
use std::time::{Duration, Instant};
use std::{env, fs};

use protocol::seed::{Purpose, Stream, stream};
use rand::RngExt;
use run::folder::{LEARNER_FILE, POLICY_FILE, PROXIMITY_FILE};
use system_tests::{Hashes, PATIENCE, Signal, TASKS, TestRun, Training, await_some, programs};

const LAGS: [&str; 2] = ["rollout.lag=0", "rollout.lag=1"];

/// Seeds of the quick test's schedules: each task twice, with either lag.
const QUICK: std::ops::Range<u64> = 0..8;

/// How often a run may be resumed; a schedule has fewer faults.
const MOST_RESUMES: usize = 12;

/// A fault that happens to a run.
#[derive(Clone, Copy, Debug)]
enum Fault {
    /// One of its processes, chosen by this number, is killed.
    Kill(usize),
    /// One of its processes, chosen by the first number, is stopped for some milliseconds.
    Hold(usize, u64),
    /// It is scaled to this number of actors.
    Scale(u64),
    /// The user presses Ctrl-C.
    Interrupt,
    /// The supervisor is killed.
    KillSupervisor,
    /// The machine loses power: everything is killed.
    KillAll,
    /// The disk is full for learner and service for some milliseconds.
    FillDisk(u64),
    /// The service may run only a sixth of the time for some milliseconds.
    SlowService(u64),
    /// The user asks for a repair of the log, whether the run is alive or not.
    Repair,
    /// The machine loses power, which damages the newest checkpoint.
    DamageCheckpoint(Damage),
}

/// Damage to a file of a checkpoint.
#[derive(Clone, Copy, Debug)]
struct Damage {
    file: &'static str,
    kind: DamageKind,
}

#[derive(Clone, Copy, Debug)]
enum DamageKind {
    /// One bit of the byte at this fraction of the file is flipped.
    Bit(f64),
    /// The four bytes there become NaN.
    NotANumber(f64),
    /// The file ends there.
    Cut(f64),
}

impl Damage {
    fn drawn(stream: &mut Stream) -> Damage {
        let files = [POLICY_FILE, LEARNER_FILE, PROXIMITY_FILE];
        let file = files[stream.random_range(0..files.len())];
        let part = stream.random_range(0.0..1.0);
        let kinds = [DamageKind::Bit(part), DamageKind::NotANumber(part), DamageKind::Cut(part)];
        Damage { file, kind: kinds[stream.random_range(0..kinds.len())] }
    }

    fn befall(self, checkpoint: &Path) {
        let path = checkpoint.join(self.file);
        let mut bytes = fs::read(&path).unwrap();
        let at = |part: f64| (part * bytes.len() as f64) as usize;
        match self.kind {
            DamageKind::Bit(part) => {
                let at = at(part);
                bytes[at] ^= 0x10;
            }
            DamageKind::NotANumber(part) => {
                let at = at(part) & !3;
                let end = (at + 4).min(bytes.len());
                bytes[at..end].copy_from_slice(&f32::NAN.to_le_bytes()[..end - at]);
            }
            DamageKind::Cut(part) => bytes.truncate(at(part)),
        }
        fs::write(&path, bytes).unwrap();
    }
}

/// Draws a schedule: milliseconds to wait, and the fault that follows, for each of two to five faults.
fn schedule(seed: u64) -> Vec<(u64, Fault)> {
    let mut stream = stream(seed, Purpose::TrainingEpisode, 0, 0);
    let fault = |stream: &mut Stream| match stream.random_range(0..14) {
        0..3 => Fault::Kill(stream.random_range(0..60)),
        3..5 => Fault::Hold(stream.random_range(0..60), stream.random_range(50..3_000)),
        5..7 => Fault::Scale(stream.random_range(1..5)),
        7 => Fault::Interrupt,
        8 => Fault::KillSupervisor,
        9 => Fault::FillDisk(stream.random_range(50..3_000)),
        10 => Fault::SlowService(stream.random_range(50..3_000)),
        11 => Fault::Repair,
        12 => Fault::DamageCheckpoint(Damage::drawn(stream)),
        _ => Fault::KillAll,
    };
    let count = stream.random_range(2..6);
    (0..count).map(|_| (stream.random_range(20..1_500), fault(&mut stream))).collect()
}

/// A kind of run: an index of a task, and one of a lag.
#[derive(Clone, Copy, Debug)]
struct Subject {
    task: usize,
    lag: usize,
}

impl Subject {
    const NAVIGATION: Subject = Subject { task: 0, lag: 0 };

    fn of(seed: u64) -> Subject {
        let seed = seed as usize;
        Subject { task: seed % TASKS.len(), lag: seed / TASKS.len() % LAGS.len() }
    }

    fn start(self, run: &TestRun) -> Training<'_> {
        let task = TASKS[self.task];
        let steps = if task == "navigation" { "steps=16000" } else { "steps=6400" };
        let settings = [steps, "resources.lease_timeout_ms=1000", LAGS[self.lag]];
        run.train_task(task, &settings)
    }

    /// The hashes of this run without faults.
    fn undisturbed(self) -> &'static Hashes {
        static HASHES: [[OnceLock<Hashes>; LAGS.len()]; TASKS.len()] =
            [const { [const { OnceLock::new() }; LAGS.len()] }; TASKS.len()];
        HASHES[self.task][self.lag].get_or_init(|| {
            let run = TestRun::new(programs!());
            self.start(&run).finish().hashes()
        })
    }
}

/// Limits the size of the files that learner and service write.
fn limit_writers(run: &TestRun, bytes: Option<u64>) {
    let writers = ["learner", "proximity-service"];
    for process in run.processes() {
        if writers.contains(&process.name.as_str()) {
            process.limit_files(bytes);
        }
    }
}

/// Makes a fault happen.
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
            // This is refused if the run is over or its supervisor has just been killed.
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
        Fault::Repair => {
            let mut repair = run.program("goalward");
            // This is refused while the run is alive.
            repair.args(["log", "repair"]).arg(run.folder().path()).output().unwrap();
        }
        Fault::DamageCheckpoint(damage) => {
            kill_all(run, training);
            if let Some((_, checkpoint)) = run.folder().newest_checkpoint() {
                damage.befall(&checkpoint);
            }
        }
        Fault::KillAll => kill_all(run, training),
    }
}

/// Kills every process of a run, and waits until none is left.
fn kill_all(run: &TestRun, training: &Training<'_>) {
    training.signal(Signal::Kill);
    await_some("the death of all processes", PATIENCE, || {
        let processes = run.processes();
        processes.iter().for_each(|process| process.signal(Signal::Kill));
        processes.is_empty().then_some(())
    });
}

/// Lists leftover files that only a running program may have, by the endings of their names.
fn unfinished_files(run: &TestRun) -> Vec<String> {
    const ENDINGS: [&str; 4] = ["unfinished", ".active", ".repairing", ".tmp"];
    let paths = run.contents().into_iter().map(|(path, _)| path.display().to_string());
    paths.filter(|path| ENDINGS.iter().any(|ending| path.ends_with(ending))).collect()
}

/// Plays a schedule; the run must end like the undisturbed one.
fn play(seed: u64) {
    let subject = Subject::of(seed);
    let expected = subject.undisturbed();
    let schedule = schedule(seed);
    let shown = format!("schedule {seed}, {}: {schedule:?}", TASKS[subject.task]);
    let run = TestRun::new(programs!());
    let mut training = subject.start(&run);
    let mut resumes = 0;
    for (milliseconds, fault) in &schedule {
        sleep(Duration::from_millis(*milliseconds));
        if run.folder().summary_file().exists() {
            break;
        }
        // Until the folder has a configuration, there is no run to resume.
        if training.has_ended() && run.folder().config_file().exists() {
            training = run.resume();
            resumes += 1;
        }
        strike(&run, &training, *fault);
    }
    while training.end() != Some(0) || !run.folder().summary_file().exists() {
        assert!(resumes < MOST_RESUMES, "{shown}: resumed too often");
        resumes += 1;
        let has_begun = run.folder().config_file().exists();
        training = if has_begun { run.resume() } else { subject.start(&run) };
    }
    assert_eq!(run.summary().hashes(), *expected, "{shown}");
    let mut verify = run.program("goalward");
    let verified = verify.arg("replay").arg(run.folder().path()).arg("--verify").output().unwrap();
    let stderr = String::from_utf8_lossy(&verified.stderr);
    assert!(verified.status.success(), "{shown}: {stderr}");
    assert_eq!(run.shared_memory(), Vec::<String>::new(), "{shown}");
    assert_eq!(run.processes(), Vec::new(), "{shown}");
    assert_eq!(unfinished_files(&run), Vec::<String>::new(), "{shown}");
}

#[test]
fn a_disk_that_fills_up_pauses_the_run() {
    let run = TestRun::new(programs!());
    let mut training = Subject::NAVIGATION.start(&run);
    training.await_checkpoint(4);
    limit_writers(&run, Some(0));
    let said = || run.remarks().contains("no room on the disk").then_some(());
    await_some("a word of the full disk", PATIENCE, said);
    let reached = || {
        let (_, text) = run.goalward(&["status", "run", "--json"]);
        let status: serde_json::Value = serde_json::from_str(&text).unwrap();
        status["progress"]["update"]["iterations"].as_u64().expect("iterations")
    };
    sleep(Duration::from_secs(1));
    let before = reached();
    sleep(Duration::from_secs(2));
    assert_eq!(reached(), before, "expected the run to wait");
    limit_writers(&run, None);
    assert_eq!(training.finish().hashes(), *Subject::NAVIGATION.undisturbed());
    assert!(!run.remarks().contains("ended"), "expected no process to die: {}", run.remarks());
    for option in ["--verify", "--retrain"] {
        let (is_whole, said) = run.goalward(&["replay", "run", option]);
        assert!(is_whole, "expected every record kept: {said}");
    }
}

#[test]
fn a_run_killed_at_its_very_end_leaves_nothing() {
    let run = TestRun::new(programs!());
    let training = Subject::NAVIGATION.start(&run);
    await_some("the summary", PATIENCE, || run.folder().summary_file().exists().then_some(()));
    strike(&run, &training, Fault::KillAll);
    training.end();
    assert_eq!(run.resume().end(), Some(0));
    assert_eq!(run.shared_memory(), Vec::<String>::new());
}

#[test]
fn random_faults_change_nothing() {
    QUICK.for_each(play);
}

/// `deploy/soak.sh` runs this test, with minutes, first seed and number of jobs in environment variables.
#[test]
#[ignore = "as long as deploy/soak.sh says"]
fn soak() {
    let number = |name: &str| env::var(name).ok().and_then(|text| text.parse().ok());
    let minutes = number("GOALWARD_SOAK_MINUTES").unwrap_or(10);
    let first = number("GOALWARD_SOAK_SEED").unwrap_or(100);
    let jobs = number("GOALWARD_SOAK_JOBS").unwrap_or(1);
    let deadline = Instant::now() + Duration::from_secs(60 * minutes);
    let next = AtomicU64::new(first);
    let failed = Mutex::new(Vec::new());
    std::thread::scope(|scope| {
        for _ in 0..jobs {
            scope.spawn(|| {
                play_until(deadline, &next, &failed);
            });
        }
    });
    let (played, failed) = (next.into_inner() - first, failed.into_inner().unwrap());
    assert!(failed.is_empty(), "{} of {played} schedules: {failed:?}", failed.len());
}

/// Plays one schedule after another, at least one, until the deadline; a failed one has printed its reason.
fn play_until(deadline: Instant, next: &AtomicU64, failed: &Mutex<Vec<u64>>) {
    loop {
        let seed = next.fetch_add(1, Ordering::Relaxed);
        if catch_unwind(|| play(seed)).is_err() {
            failed.lock().unwrap().push(seed);
        } else {
            writeln!(std::io::stdout(), "schedule {seed}: nothing changed").ok();
        }
        if Instant::now() >= deadline {
            return;
        }
    }
}
