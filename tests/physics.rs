//! The physics tasks through the whole system: the results are the same bits whatever the number of actors and
//! whichever process is killed, and a viewer can draw the evaluation episodes.
//!
//! Method: small runs of the real programs, compared by the hashes of `summary.json`.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::collections::BTreeSet;
use std::fs;

use bus::{Bus, BusAddress, NewestSubscriber};
use mcap_log::{FileReader, Record};
use prost::Message;
use protocol::messages::Progress;
use protocol::trajectory::Encoded;
use system_tests::{PATIENCE, Signal, TestRun, await_some, programs, spec};

/// The method that trains the expert of ANT REACH.
const ON_ITS_OWN_REWARD: &str = "method=environment-reward";

fn disturbance_changes_nothing(task: &str) {
    let train = |run: &TestRun, actors| run.train_task(task, &[actors]).finish();
    let undisturbed = train(&TestRun::new(programs!()), "resources.actors=1");
    let run = TestRun::new(programs!());
    let mut training = run.train_task(task, &["resources.actors=3"]);
    training.await_checkpoint(2);
    run.process("actor-1").signal(Signal::Kill);
    let disturbed = training.finish();
    assert_eq!(disturbed.iterations, 8);
    assert_eq!(disturbed.hashes(), undisturbed.hashes());
    assert!(run.remarks().contains("actor-1 ended (signal: 9"), "{}", run.remarks());
}

#[test]
fn actors_and_a_kill_change_nothing_in_fetch_pick() {
    disturbance_changes_nothing("fetch-pick");
}

#[test]
fn actors_and_a_kill_change_nothing_in_fetch_push() {
    disturbance_changes_nothing("fetch-push");
}

#[test]
fn actors_and_a_kill_change_nothing_in_ant_reach() {
    disturbance_changes_nothing("ant-reach");
}

/// With lag 1 the acting policy is in no checkpoint. Its leases fill the only actor, which is stopped while the
/// learner is killed, goes back to a checkpoint and publishes older policies.
#[test]
fn an_actor_lets_go_of_leases_whose_policy_died_with_the_learner() {
    let settings = ["rollout.lag=1", "rollout.lanes=32", "rollout.lane_steps=60"];
    let rest = ["steps=17280", "checkpoint.iterations=4", "resources.actors=1"];
    let train = |run| TestRun::train_task(run, "fetch-push", &[settings, rest].concat());
    let undisturbed = TestRun::new(programs!());
    let undisturbed = train(&undisturbed).finish();
    let run = TestRun::new(programs!());
    let mut training = train(&run);
    training.await_checkpoint(4);
    let bus: Bus = Bus::open(&BusAddress::of_run(run.folder().path()).unwrap(), "test").unwrap();
    let progress = bus.progress_subscriber().unwrap();
    // Version 6 has been made, so version 5 acts; the checkpoint has versions 3 and 4.
    await_progress(&progress, "leases of the fifth version", |told| {
        told.leases >= 16 && told.update.as_ref().is_some_and(|update| update.policy_version >= 6)
    });
    let actor = run.process("actor-0");
    actor.signal(Signal::Stop);
    run.process("learner").signal(Signal::Kill);
    await_progress(&progress, "a learner that has gone back", |told| {
        told.update.is_none() && told.reward_update.is_some()
    });
    actor.signal(Signal::Continue);
    assert_eq!(training.finish().hashes(), undisturbed.hashes());
    assert!(run.remarks().contains("learner ended (signal: 9"), "{}", run.remarks());
}

fn await_progress(progress: &NewestSubscriber, what: &str, is_it: impl Fn(&Progress) -> bool) {
    await_some(what, PATIENCE, || {
        let bytes = progress.receive().unwrap()?;
        is_it(&Progress::decode(bytes).unwrap()).then_some(())
    });
}

#[test]
fn an_evaluation_can_be_drawn() {
    for (task, settings) in [("fetch-push", &[][..]), ("ant-reach", &[ON_ITS_OWN_REWARD])] {
        let run = TestRun::new(programs!());
        run.train_task(task, settings).finish();
        let mut evaluate = run.program("goalward");
        evaluate.arg("evaluate").arg(run.folder().path()).args(["--episodes", "3"]);
        assert!(evaluate.status().unwrap().success());

        let (mut observations, mut frames) = (0, 0);
        let mut names = BTreeSet::new();
        for entry in FileReader::open(&evaluation_file(&run)).unwrap() {
            match entry.unwrap().record {
                Record::EvaluationTrajectory(bytes) => {
                    let encoded = Encoded::decode(bytes, &spec(task)).unwrap();
                    observations += encoded.trajectory.steps + 1;
                }
                Record::Scene(scene) => {
                    frames += 1;
                    names.extend(scene.entities.into_iter().map(|entity| entity.id));
                }
                other => panic!("expected episodes and scenes, found {other:?}"),
            }
        }
        assert_eq!(frames, observations, "{task}: one frame for every observation");
        assert!(names.len() >= 5 && names.contains("goal"), "{task}: {names:?}");
    }
}

fn evaluation_file(run: &TestRun) -> std::path::PathBuf {
    let entries = fs::read_dir(run.folder().path()).unwrap().map(|entry| entry.unwrap().path());
    let name = |path: &std::path::PathBuf| {
        path.file_name().unwrap().to_string_lossy().starts_with("evaluation-")
    };
    entries.into_iter().find(name).unwrap()
}
