//! A run from its log: every recorded episode acts again as it was recorded, and one that does not is
//! named.
//!
//! Method: small runs of the real programs. A record is changed by copying the log, as a tool would,
//! with `protocol::log` alone.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::fs;
use std::process::Output;

use protocol::log::{LogOptions, LogWriter, Record, read_run};
use protocol::task::Task;
use protocol::trajectory::{Encoded, Trajectory};
use system_tests::{SMALL, SMALL_PHYSICS, TestRun, programs};

fn verify(run: &TestRun) -> Output {
    let mut replay = run.program("goalward");
    replay.arg("replay").arg(run.folder().path()).arg("--verify").output().unwrap()
}

#[test]
fn every_episode_of_every_task_acts_again_as_it_was_recorded() {
    for task in [Task::Navigation, Task::FetchPick, Task::FetchPush, Task::AntReach] {
        let run = TestRun::new(programs!());
        let small = if task == Task::Navigation { &SMALL[..] } else { &SMALL_PHYSICS };
        let summary = run.train_task(task.name(), small, &[]).finish();
        let Output { status, stdout, stderr } = verify(&run);
        let (stdout, stderr) = (String::from_utf8_lossy(&stdout), String::from_utf8_lossy(&stderr));
        assert!(status.success(), "{task}: {stdout}{stderr}");
        let config = run.folder().config().unwrap();
        let episodes =
            summary.episodes + summary.evaluation.episodes + config.demonstrations.episodes;
        assert!(stdout.contains(&format!("{episodes} of {episodes} episodes")), "{task}: {stdout}");
    }
}

/// Writes the run's log again with `change` made to every training trajectory.
fn rewrite(run: &TestRun, change: impl Fn(&mut Trajectory)) {
    let (log, old) = (run.folder().log(), run.path("old-log"));
    fs::rename(&log, &old).unwrap();
    let mut reader = read_run(&old).unwrap();
    let mut writer = LogWriter::create(&log, reader.metadata(), LogOptions::default()).unwrap();
    for entry in &mut reader {
        let Record::Trajectory(bytes) = entry.unwrap().record else { continue };
        let mut trajectory = Encoded::decode(bytes, &Task::Navigation.spec()).unwrap().trajectory;
        change(&mut trajectory);
        writer.trajectory(&Encoded::encode(trajectory)).unwrap();
    }
    writer.finish().unwrap();
}

#[test]
fn an_episode_that_cannot_have_happened_is_named() {
    let run = TestRun::new(programs!());
    run.finish(&[]);
    let wrong = |trajectory: &Trajectory| (trajectory.lane, trajectory.episode) == (2, 3);
    rewrite(&run, |trajectory| trajectory.state_hash ^= u64::from(wrong(trajectory)));
    let Output { status, stderr, .. } = verify(&run);
    let stderr = String::from_utf8_lossy(&stderr);
    assert_eq!(status.code(), Some(1), "{stderr}");
    assert!(stderr.contains("1 of ") && stderr.contains("lane 2 episode 3, step "), "{stderr}");
}

#[test]
fn a_log_that_is_cut_off_is_verified_as_far_as_it_goes() {
    let run = TestRun::new(programs!());
    run.finish(&[]);
    let file = run.folder().log().join("trajectories-00000.mcap");
    let bytes = fs::read(&file).unwrap();
    fs::write(&file, &bytes[..bytes.len() * 2 / 3]).unwrap();
    let Output { status, stdout, stderr } = verify(&run);
    let (stdout, stderr) = (String::from_utf8_lossy(&stdout), String::from_utf8_lossy(&stderr));
    assert_eq!(status.code(), Some(3), "{stdout}{stderr}");
    assert!(stdout.contains("the same") && stderr.contains("cut off"), "{stdout}{stderr}");
}
