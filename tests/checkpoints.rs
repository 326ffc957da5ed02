//! A run continues only from what was saved: a damaged checkpoint is skipped for the one before it, offline training
//! continues where it was stopped, and replaced demonstrations or a log without the data that must be replayed are
//! refused. In every case the final hashes are those of the undisturbed run.
//!
//! Method: a run of the real programs is stopped, files in its folder are damaged, and it is resumed.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::fs;
use std::time::{Duration, Instant};

use bus::{Bus, BusAddress};
use prost::Message;
use protocol::messages::Progress;
use run::folder::{LEARNER_FILE, POLICY_FILE, PROXIMITY_FILE};
use system_tests::{
    CHECKPOINT_ITERATIONS, Hashes, PATIENCE, Signal, TestRun, await_some, programs,
};

/// Makes a run of forty iterations.
const LONG: &str = "steps=16000";

/// Makes offline training last many seconds.
const MUCH_OFFLINE: [&str; 2] = ["reward.pretraining_epochs=150", "steps=800"];

/// How long a stop may take on a busy machine; an idle one needs a second.
const STOP_PATIENCE: Duration = Duration::from_secs(8);

fn undisturbed(settings: &[&str]) -> Hashes {
    TestRun::new(programs!()).finish(settings).hashes()
}

/// Damages a file of the newest checkpoint; returns the checkpoint's iteration.
fn damage(run: &TestRun, name: &str, how: impl Fn(Vec<u8>) -> Vec<u8>) -> u64 {
    let (iteration, folder) = run.folder().newest_checkpoint().unwrap();
    let path = folder.join(name);
    let bytes = fs::read(&path).unwrap();
    fs::write(path, how(bytes)).unwrap();
    iteration
}

fn flip(mut bytes: Vec<u8>) -> Vec<u8> {
    let at = bytes.len() - 3;
    bytes[at] ^= 1;
    bytes
}

/// Turns the bytes of a file into damaged ones.
type Damage = dyn Fn(Vec<u8>) -> Vec<u8>;

#[test]
fn a_damaged_checkpoint_is_passed_over() {
    let run = TestRun::new(programs!());
    let mut training = run.train(&[LONG]);
    let put_nan = |mut bytes: Vec<u8>| {
        let at = bytes.len() - 4;
        bytes[at..].copy_from_slice(&f32::NAN.to_le_bytes());
        bytes
    };
    let halve = |bytes: Vec<u8>| bytes[..bytes.len() / 2].to_vec();
    let damages: [(u64, &str, &Damage); 3] =
        [(8, LEARNER_FILE, &flip), (16, PROXIMITY_FILE, &put_nan), (24, POLICY_FILE, &halve)];
    for (checkpoint, name, how) in damages {
        training.await_checkpoint(checkpoint);
        training.signal(Signal::Interrupt);
        training.end();
        let damaged = damage(&run, name, how);
        let before = run.folder().checkpoint_folders().len();
        training = run.resume();
        let aside = run.folder().checkpoint_folder(damaged).with_extension("damaged");
        await_some("the damaged checkpoint laid aside", PATIENCE, || aside.exists().then_some(()));
        let shown = format!("{damaged:06}/{name}");
        let is_said = || run.remarks().contains(&shown).then_some(());
        await_some("a line about it", PATIENCE, is_said);
        assert!(before > 1, "expected older checkpoints");
        assert!(!run.remarks().contains("starts over"), "{}", run.remarks());
    }
    assert_eq!(training.finish().hashes(), undisturbed(&[LONG]));
    assert!(!run.remarks().contains("ended"), "no process died: {}", run.remarks());
}

#[test]
fn a_run_without_a_checkpoint_that_holds_begins_anew_and_no_damaged_policy_is_evaluated() {
    let run = TestRun::new(programs!());
    let mut training = run.train(&[LONG]);
    training.await_checkpoint(4);
    training.signal(Signal::Interrupt);
    training.end();
    let evaluated = || {
        let mut evaluate = run.program("goalward");
        let output = evaluate.arg("evaluate").arg(run.folder().path()).output().unwrap();
        (output.status.code(), String::from_utf8(output.stderr).unwrap())
    };
    for (_, folder) in run.folder().checkpoint_folders() {
        let path = folder.join(POLICY_FILE);
        let bytes = fs::read(&path).unwrap();
        fs::write(path, flip(bytes)).unwrap();
    }
    let (code, said) = evaluated();
    assert!(code == Some(1) && said.contains("found none"), "{code:?} {said}");
    assert_eq!(run.resume().finish().hashes(), undisturbed(&[LONG]));
    assert!(run.remarks().contains("the run starts over"), "{}", run.remarks());
    assert_eq!(evaluated().0, Some(0));
}

/// SQIL rebuilds its replay buffer from the log, which is the only place that has it.
#[test]
fn a_run_that_replays_is_not_continued_on_a_log_that_lacks_updates() {
    let run = TestRun::new(programs!());
    let mut training = run.train(&[
        "method=sqil",
        "sqil.batch=8",
        "sqil.updates_per_step=0.05",
        "sqil.exploration_steps=800",
        "steps=64000",
    ]);
    training.await_checkpoint(CHECKPOINT_ITERATIONS);
    training.signal(Signal::Interrupt);
    assert_eq!(training.end(), Some(130));
    let (reached, _) = run.folder().newest_checkpoint().unwrap();
    let mut training = run.resume();
    training.await_checkpoint((reached / CHECKPOINT_ITERATIONS + 1) * CHECKPOINT_ITERATIONS);
    training.signal(Signal::Interrupt);
    assert_eq!(training.end(), Some(130));

    // The newest checkpoint is recorded in the next file.
    fs::remove_file(run.folder().log().join("updates-00000.mcap")).unwrap();
    assert_eq!(run.resume().end(), Some(1));
    let remarks = run.remarks();
    assert!(remarks.contains("to learn from again, found no update 0"), "{remarks}");
    assert!(!remarks.contains("restarting learner"), "expected no restart: {remarks}");
    assert_eq!(run.shared_memory(), Vec::<String>::new());
}

#[test]
fn swapped_demonstrations_are_refused() {
    let run = TestRun::new(programs!());
    let mut training = run.train(&[]);
    training.await_checkpoint(4);
    training.signal(Signal::Interrupt);
    training.end();
    let file = run.folder().demonstrations_file();
    let own = fs::read(&file).unwrap();
    let mut record = run.program("goalward");
    record.args(["demonstrate", "navigation", "--episodes", "40", "--seed", "7", "--out"]);
    let other = run.path("other.mcap");
    assert!(record.arg(&other).status().unwrap().success());
    fs::copy(other, &file).unwrap();
    assert_eq!(run.resume().end(), Some(2));
    let remarks = run.remarks();
    assert!(remarks.contains("demonstrations.mcap: expected SHA-256"), "{remarks}");
    fs::write(&file, own).unwrap();
    assert_eq!(run.resume().finish().hashes(), undisturbed(&[]));
}

#[test]
fn offline_training_is_stopped_at_once_and_goes_on_where_it_was() {
    let expected = undisturbed(&MUCH_OFFLINE);
    let run = TestRun::new(programs!());
    let training = run.train(&MUCH_OFFLINE);
    let first = await_steps(&run, 100);
    let begun = Instant::now();
    training.signal(Signal::Interrupt);
    assert_eq!(training.end(), Some(130));
    assert!(begun.elapsed() < STOP_PATIENCE, "stopped after {:?}", begun.elapsed());
    let kept = run.folder().offline_file();
    assert!(kept.exists(), "expected what the service has trained in {}", kept.display());

    // Once the supervisor is killed, nobody restarts the service, so the learner ends, too.
    let training = run.resume();
    let second = await_steps(&run, 1);
    assert!(second >= first, "begun anew: {second} gradient steps after {first}");
    training.signal(Signal::Kill);
    run.process("proximity-service").signal(Signal::Kill);
    training.end();
    await_some("the learner's end", PATIENCE, || run.processes().is_empty().then_some(()));

    let training = run.resume();
    let third = await_steps(&run, 1);
    assert!(third >= first, "begun anew: {third} gradient steps after {first}");
    assert_eq!(training.finish().hashes(), expected);
    assert!(!kept.exists(), "expected it to be removed with the first checkpoint");
}

/// Gradient steps this large overflow at once.
#[test]
fn training_that_diverges_ends_the_run_at_once_and_says_why() {
    for (setting, parts) in [
        ("ppo.learning_rate=1e30", ["the learner diverged", "epoch 1, minibatch "]),
        ("reward.learning_rate=1e30", ["the reward model diverged", "member 0"]),
    ] {
        let run = TestRun::new(programs!());
        assert_eq!(run.train(&[setting]).end(), Some(1), "{setting}: {}", run.remarks());
        let log = fs::read_dir(run.folder().log()).unwrap();
        let unsealed = log.filter(|file| {
            file.as_ref().unwrap().path().extension().is_some_and(|ending| ending == "active")
        });
        assert_eq!(unsealed.count(), 0, "{setting}: the log is sealed");
        let remarks = run.remarks();
        for part in parts {
            assert!(remarks.contains(part), "{setting}: expected {part} in {remarks}");
        }
        assert!(
            !remarks.contains("restarting learner"),
            "{setting}: expected no restart: {remarks}"
        );
        assert_eq!(run.folder().checkpoint_folders(), [], "{setting}: nothing of it is saved");
        assert_eq!(run.resume().end(), Some(1), "{setting}: resumed, it comes to the same");
        assert_eq!(run.shared_memory(), Vec::<String>::new());
    }
}

/// Waits until offline training has taken at least `wanted` gradient steps; returns how many it has taken.
fn await_steps(run: &TestRun, wanted: u64) -> u64 {
    run.process("learner");
    let address = BusAddress::of_run(run.folder().path()).unwrap();
    let bus: Bus = Bus::open(&address, "test").unwrap();
    let progress = bus.progress_subscriber().unwrap();
    await_some("gradient steps of offline training", PATIENCE, || {
        let told = Progress::decode(progress.receive().unwrap()?).unwrap();
        Some(told.pretraining?.done).filter(|&done| done >= wanted)
    })
}
