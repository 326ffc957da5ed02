//! The physics tasks through the whole system: the same bits whatever the number of actors and
//! whoever is killed, and evaluation episodes that a viewer can draw.
//!
//! Method: small runs of the real programs, compared by the hashes of `summary.json`.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::collections::BTreeSet;
use std::fs;

use protocol::log::{FileReader, Record};
use protocol::task::Task;
use protocol::trajectory::Encoded;
use system_tests::{SMALL_PHYSICS, Signal, TestRun, programs};

/// As the expert of Ant Reach is trained.
const ON_ITS_OWN_REWARD: &str = "method=environment-reward";

fn disturbance_changes_nothing(task: &str) {
    let train = |run: &TestRun, actors| run.train_task(task, &SMALL_PHYSICS, &[actors]).finish();
    let undisturbed = train(&TestRun::new(programs!()), "resources.actors=1");
    let run = TestRun::new(programs!());
    let mut training = run.train_task(task, &SMALL_PHYSICS, &["resources.actors=3"]);
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

#[test]
fn an_evaluation_can_be_drawn() {
    for (task, settings) in [(Task::FetchPush, &[][..]), (Task::AntReach, &[ON_ITS_OWN_REWARD])] {
        let run = TestRun::new(programs!());
        run.train_task(task.name(), &SMALL_PHYSICS, settings).finish();
        let mut evaluate = run.program("goalward");
        evaluate.arg("evaluate").arg(run.folder().path()).args(["--episodes", "3"]);
        assert!(evaluate.status().unwrap().success());

        let (mut observations, mut frames) = (0, 0);
        let mut names = BTreeSet::new();
        for entry in FileReader::open(&evaluation_file(&run)).unwrap() {
            match entry.unwrap().record {
                Record::EvaluationTrajectory(bytes) => {
                    let encoded = Encoded::decode(bytes, &task.spec()).unwrap();
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
