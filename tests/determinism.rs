//! The same configuration, seed and programs give the same weights, bit for bit: whatever the number of actors and
//! threads, whichever process is killed, however often the run is stopped.
//!
//! Method: one undisturbed run is the reference. Every test trains the same run in another way and compares the two
//! hashes of `summary.json`. Signals are sent once a certain checkpoint has appeared and the run is still going on,
//! so they certainly come in the middle; the supervisor's remarks prove that they had an effect. Another seed and
//! another lag show that the hashes can differ.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::sync::LazyLock;

use system_tests::{Hashes, ITERATIONS, PATIENCE, Signal, TestRun, await_some, programs};

/// The hashes of the undisturbed run, with two actors and lag 0.
static UNDISTURBED: LazyLock<Hashes> = LazyLock::new(|| trained(&[]));

fn trained(settings: &[&str]) -> Hashes {
    let summary = TestRun::new(programs!()).finish(settings);
    assert_eq!(summary.iterations, ITERATIONS);
    summary.hashes()
}

#[test]
fn actors_and_threads_change_nothing() {
    let threads = ["resources.learner_threads=1", "resources.service_threads=1"];
    let one = trained(&["resources.actors=1", threads[0], threads[1]]);
    assert_eq!(one, *UNDISTURBED);
    let threads = ["resources.learner_threads=3", "resources.service_threads=3"];
    let four = trained(&["resources.actors=4", threads[0], threads[1]]);
    assert_eq!(four, *UNDISTURBED);
}

#[test]
fn actors_that_come_and_go_change_nothing() {
    let run = TestRun::new(programs!());
    let mut training = run.train(&["resources.actors=1"]);
    for (checkpoint, actors) in [(4, "4"), (8, "2")] {
        training.await_checkpoint(checkpoint);
        let mut scale = run.program("goalward");
        scale.arg("scale").arg(run.folder().path()).args(["--actors", actors]);
        assert!(scale.status().unwrap().success());
        expect_actors(&run, actors.parse().unwrap());
    }
    assert_eq!(training.finish().hashes(), *UNDISTURBED);
    expect_remark(&run, "actors: 2 from now on");
}

/// Waits until exactly `count` actors are alive.
fn expect_actors(run: &TestRun, count: usize) {
    await_some("the actors wanted", PATIENCE, || {
        let processes = run.processes();
        let actors = processes.iter().filter(|process| process.name.starts_with("actor"));
        (actors.count() == count).then_some(())
    });
}

#[test]
fn actors_change_nothing_with_lag_1() {
    let [one, two, four] = ["resources.actors=1", "resources.actors=2", "resources.actors=4"]
        .map(|actors| trained(&["rollout.lag=1", actors]));
    assert_eq!(one, two);
    assert_eq!(one, four);
    assert_ne!(one.policy, UNDISTURBED.policy);
    assert_ne!(one.proximity, UNDISTURBED.proximity);
}

#[test]
fn another_seed_learns_something_else() {
    let other = trained(&["seed=2"]);
    assert_ne!(other.policy, UNDISTURBED.policy);
    assert_ne!(other.proximity, UNDISTURBED.proximity);
}

#[test]
fn killed_actors_change_nothing() {
    let run = TestRun::new(programs!());
    let mut training = run.train(&[]);
    for (checkpoint, actor) in [(4, "actor-0"), (8, "actor-1"), (12, "actor-0")] {
        training.await_checkpoint(checkpoint);
        run.process(actor).signal(Signal::Kill);
    }
    assert_eq!(training.finish().hashes(), *UNDISTURBED);
    expect_remark(&run, "actor-0 ended (signal: 9");
    expect_remark(&run, "actor-1 ended (signal: 9");
}

#[test]
fn a_killed_learner_changes_nothing() {
    killed_in_the_middle("learner");
}

#[test]
fn a_killed_proximity_service_changes_nothing() {
    killed_in_the_middle("proximity-service");
}

fn killed_in_the_middle(process: &str) {
    let run = TestRun::new(programs!());
    let mut training = run.train(&[]);
    training.await_checkpoint(8);
    run.process(process).signal(Signal::Kill);
    assert_eq!(training.finish().hashes(), *UNDISTURBED);
    expect_remark(&run, &format!("{process} ended (signal: 9"));
    expect_remark(
        &run,
        "restarting learner and proximity service from the checkpoint after iteration",
    );
}

#[test]
fn what_dies_before_the_first_checkpoint_begins_again() {
    let run = TestRun::new(programs!());
    let training = run.train(&["checkpoint.iterations=1000"]);
    let learner = run.process("learner");
    // By then there are trajectories in the log, and all of them must be made again.
    await_some("a log", PATIENCE, || {
        let files = mcap_log::log_files(&run.folder().log()).unwrap_or_default();
        (!files.is_empty()).then_some(())
    });
    learner.signal(Signal::Kill);
    assert_eq!(training.finish().hashes(), *UNDISTURBED);
    expect_remark(&run, "restarting learner and proximity service from the beginning");
}

#[test]
fn a_stopped_and_resumed_run_is_the_same() {
    let run = TestRun::new(programs!());
    let mut training = run.train(&[]);
    training.await_checkpoint(8);
    training.signal(Signal::Interrupt);
    assert_eq!(training.end(), Some(130));
    let (stopped_at, _) = run.folder().newest_checkpoint().unwrap();
    assert!((8..ITERATIONS).contains(&stopped_at), "stopped after {stopped_at} iterations");
    assert!(!run.folder().summary_file().exists());

    let resumed = run.resume().finish();
    assert_eq!(resumed.iterations, ITERATIONS);
    assert_eq!(resumed.hashes(), *UNDISTURBED);
}

#[test]
fn a_run_whose_supervisor_was_killed_is_resumed_the_same() {
    let run = TestRun::new(programs!());
    let mut training = run.train(&["rollout.lag=0"]);
    training.await_checkpoint(8);
    training.signal(Signal::Kill);
    assert_eq!(training.end(), None);
    // Resume at once: the new supervisor itself waits for the old one's processes.
    assert_eq!(run.resume().finish().hashes(), *UNDISTURBED);
}

fn expect_remark(run: &TestRun, part: &str) {
    let remarks = run.remarks();
    assert!(remarks.contains(part), "expected `{part}` in\n{remarks}");
    let kept = std::fs::read_to_string(run.folder().output().join("supervisor.log")).unwrap();
    assert!(kept.contains(part), "expected `{part}` for those who look later in\n{kept}");
}
