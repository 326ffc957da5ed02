//! Replaying a run from its log: re-simulation reproduces every recorded episode and names one that differs, and
//! retraining, publishing, rescoring and restoring work from the log alone.
//!
//! Method: small runs of the real programs. To change a record, the log is copied, as a tool would do it, with
//! `mcap_log` alone.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::collections::BTreeSet;
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Output, Stdio};

use bus::{Bus, BusAddress, Published};
use bytes::Bytes;
use mcap_log::{Record, read_run, rewrite};
use prost::Message;
use protocol::Error;
use protocol::trajectory::{Encoded, Source, Trajectory};
use system_tests::{PATIENCE, Signal, Summary, TestRun, await_some, programs, send, spec};

fn replay(run: &TestRun, what: &[&str]) -> Output {
    let mut replay = run.program("goalward");
    replay.arg("replay").arg(run.folder().path()).args(what).output().unwrap()
}

fn verify(run: &TestRun) -> Output {
    replay(run, &["--verify"])
}

#[test]
fn every_episode_of_every_task_acts_again_as_it_was_recorded() {
    for task in ["navigation", "fetch-pick", "fetch-push", "ant-reach"] {
        let run = TestRun::new(programs!());
        let summary = run.train_task(task, &[]).finish();
        let Output { status, stdout, stderr } = verify(&run);
        let (stdout, stderr) = (String::from_utf8_lossy(&stdout), String::from_utf8_lossy(&stderr));
        assert!(status.success(), "{task}: {stdout}{stderr}");
        let config = run.folder().config().unwrap();
        let episodes =
            summary.episodes + summary.evaluation.episodes + config.demonstrations.episodes;
        assert!(stdout.contains(&format!("{episodes} of {episodes} episodes")), "{task}: {stdout}");
    }
}

/// Rewrites the run's log with `change` applied to every trajectory.
fn change_log(run: &TestRun, change: impl Fn(&mut Trajectory)) {
    let (log, old) = (run.folder().log(), run.path("old-log"));
    fs::rename(&log, &old).unwrap();
    let changed = |bytes: Bytes| {
        let mut trajectory = Trajectory::recorded(bytes, &spec("navigation"))?;
        change(&mut trajectory);
        Ok(trajectory.encode_to_vec().into())
    };
    let all = |old: Vec<Bytes>| old.into_iter().map(changed).collect::<Result<_, Error>>();
    rewrite(&old, &log, 4096, all).unwrap();
}

#[test]
fn an_episode_that_cannot_have_happened_is_named() {
    let run = TestRun::new(programs!());
    run.finish(&[]);
    let wrong = |trajectory: &Trajectory| {
        let Trajectory { lane, episode, .. } = *trajectory;
        (trajectory.source(), lane, episode) == (Source::Training, 2, 3)
    };
    change_log(&run, |trajectory| trajectory.state_hash ^= u64::from(wrong(trajectory)));
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

#[test]
fn a_run_is_trained_again_from_its_log_alone() {
    for settings in [&[][..], &["rollout.lag=1"], &["method=environment-reward"]] {
        let run = TestRun::new(programs!());
        let summary = run.finish(settings);
        let out = run.path("again");
        let Output { status, stdout, stderr } =
            replay(&run, &["--retrain", "--out", out.to_str().unwrap()]);
        let (stdout, stderr) = (String::from_utf8_lossy(&stdout), String::from_utf8_lossy(&stderr));
        assert!(status.success(), "{settings:?}: {stdout}{stderr}");
        assert!(stdout.contains(&summary.policy_sha256), "{settings:?}: {stdout}");
        let again = fs::read_to_string(out.join("summary.json")).unwrap();
        let again: Summary = serde_json::from_str(&again).unwrap();
        assert_eq!(again.hashes(), summary.hashes());
        assert_eq!(again.evaluation, summary.evaluation);
    }
}

#[test]
fn a_run_that_was_killed_is_trained_again_as_far_as_its_log_goes() {
    let run = TestRun::new(programs!());
    let mut training = run.train(&["steps=4000000"]);
    training.await_checkpoint(8);
    for process in run.processes() {
        process.signal(Signal::Kill);
    }
    training.signal(Signal::Kill);
    training.end();
    let Output { status, stdout, stderr } = replay(&run, &["--retrain"]);
    let (stdout, stderr) = (String::from_utf8_lossy(&stdout), String::from_utf8_lossy(&stderr));
    assert!(status.success(), "{stdout}{stderr}");
    assert!(stdout.contains("the weights after"), "{stdout}");
    assert!(!run.folder().path().join("retrained").exists(), "removed when all is the same");

    let Output { status, stdout, .. } = replay(&run, &["--retrain", "--until", "3"]);
    let stdout = String::from_utf8_lossy(&stdout);
    // Three updates of the policy, three of the ensemble, and its offline training make seven.
    assert!(status.success() && stdout.contains("the weights after 7 updates"), "{stdout}");
}

#[test]
fn a_run_whose_log_was_changed_is_trained_into_other_weights() {
    let run = TestRun::new(programs!());
    run.finish(&[]);
    change_log(&run, |trajectory| {
        if trajectory.source() == Source::Training && trajectory.iteration == 5 {
            let log_probs = trajectory.log_probs.iter().map(|&byte| byte ^ 1).collect::<Vec<_>>();
            trajectory.log_probs = log_probs.into();
        }
    });
    let Output { status, stderr, .. } = replay(&run, &["--retrain"]);
    let stderr = String::from_utf8_lossy(&stderr);
    assert_eq!(status.code(), Some(1), "{stderr}");
    assert!(stderr.contains("the policy differs first after update 6"), "{stderr}");
}

#[test]
fn a_log_is_published_for_whoever_listens() {
    let run = TestRun::new(programs!());
    let summary = run.finish(&[]);
    let bus: Bus = Bus::open(&BusAddress::of_run(run.folder().path()).unwrap(), "test").unwrap();
    let subscriber = bus.trajectory_subscriber().unwrap();
    let mut listening = Command::new(env!("CARGO_BIN_EXE_listen-under-test"));
    listening.arg(run.folder().path()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut listening = listening.spawn().unwrap();
    let mut line = String::new();
    BufReader::new(listening.stderr.take().unwrap()).read_line(&mut line).unwrap();
    assert!(line.contains("listening"), "{line}");
    let mut publishing = run.program("goalward");
    publishing.arg("replay").arg(run.folder().path()).arg("--publish");
    publishing.stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut publishing = publishing.spawn().unwrap();
    let mut said = BufReader::new(publishing.stderr.take().unwrap());
    line.clear();
    said.read_line(&mut line).unwrap();
    assert!(line.contains("once a subscriber is there"), "{line}");
    let mut hashes = BTreeSet::new();
    await_some("every trajectory of the log", PATIENCE, || {
        while let Some(Published { header, bytes, .. }) = subscriber.receive().unwrap() {
            let encoded = Encoded::decode(bytes, &spec("navigation")).unwrap();
            assert_eq!(header.hash, encoded.key.hash);
            hashes.insert(header.hash);
        }
        (hashes.len() as u64 == summary.log.trajectories).then_some(())
    });
    line.clear();
    BufReader::new(publishing.stdout.take().unwrap()).read_line(&mut line).unwrap();
    assert_eq!(line, format!("published {} trajectories; readers: 2\n", hashes.len()));
    assert!(publishing.wait().unwrap().success());
    listening.kill().unwrap();
    let heard = String::from_utf8(listening.wait_with_output().unwrap().stdout).unwrap();
    assert_eq!(heard.lines().count(), hashes.len());
    assert!(
        heard.lines().all(|line| line.contains(" steps, ") && line.starts_with("lane ")),
        "{heard}"
    );
}

#[test]
fn recorded_episodes_are_scored_again_by_another_reward() {
    let run = TestRun::new(programs!());
    let summary = run.finish(&[]);
    let returns = |what: &[&str]| {
        let Output { status, stdout, stderr } = replay(&run, what);
        let (stdout, stderr) = (String::from_utf8_lossy(&stdout), String::from_utf8_lossy(&stderr));
        assert!(status.success(), "{what:?}: {stdout}{stderr}");
        let lines = fs::read_to_string(run.folder().path().join("rescored.csv")).unwrap();
        let both = |line: &str| {
            let (line, other) = line.rsplit_once(',').unwrap();
            let recorded = line.rsplit_once(',').unwrap().1;
            [recorded, other].map(|number| number.parse::<f64>().unwrap())
        };
        lines.lines().skip(1).map(both).collect::<Vec<_>>()
    };
    // The same reward gives the recorded rewards again.
    let same = returns(&["--with", "reward.uncertainty=0.01"]);
    assert_eq!(same.len() as u64, summary.episodes);
    assert!(same.iter().all(|[recorded, other]| recorded == other));
    let dearer = returns(&["--with", "reward.uncertainty=0.5", "--force"]);
    assert!(dearer.iter().all(|[recorded, other]| other < recorded));
    let own = run.folder().path().display().to_string();
    let trained = returns(&["--with", &format!("model={own}"), "--force"]);
    assert!(trained.iter().any(|[recorded, other]| recorded != other));

    let refused = replay(&run, &["--with", "ppo.clip=0.1"]);
    let stderr = String::from_utf8_lossy(&refused.stderr);
    assert_eq!(refused.status.code(), Some(2), "{stderr}");
    assert!(stderr.contains("--with ppo.clip=0.1: expected a key such as"), "{stderr}");
}

/// Returns every trajectory of a log as encoded, including its observations.
fn trajectories(log: &Path, task: &str) -> BTreeSet<Bytes> {
    let full = |bytes| Encoded::decode(bytes, &spec(task)).unwrap().bytes;
    let records = read_run(log).unwrap().map(|entry| entry.unwrap().record);
    records.filter_map(Record::trajectory).map(full).collect()
}

fn expect_no_restored_log(run: &TestRun) {
    let entries =
        fs::read_dir(run.folder().path()).unwrap().map(|entry| entry.unwrap().file_name());
    let names: Vec<_> = entries.map(|name| name.to_string_lossy().into_owned()).collect();
    assert!(!names.iter().any(|name| name.starts_with("restored-log")), "{names:?}");
}

#[test]
fn publishing_for_nobody_can_be_stopped() {
    let run = TestRun::new(programs!());
    run.finish(&["log.observations=false"]);
    let mut publishing = run.program("goalward");
    publishing.args(["replay", "run", "--publish"]).stdout(Stdio::null()).stderr(Stdio::piped());
    let mut publishing = publishing.spawn().unwrap();
    let mut lines = BufReader::new(publishing.stderr.take().unwrap()).lines().map_while(Result::ok);
    let ready = lines.find(|line| line.contains("once a subscriber is there"));
    assert!(ready.is_some(), "expected that it is about to publish");
    await_some("the publisher", PATIENCE, || (!run.shared_memory().is_empty()).then_some(()));
    send(publishing.id(), Signal::Interrupt);
    assert_eq!(publishing.wait().unwrap().code(), Some(130));
    expect_no_restored_log(&run);
    assert_eq!(run.shared_memory(), [""; 0]);
}

#[test]
fn a_log_of_actions_only_does_all_that_a_full_one_does() {
    for task in ["navigation", "fetch-push"] {
        let full = TestRun::new(programs!());
        let expected = full.train_task(task, &[]).finish();
        let run = TestRun::new(programs!());
        let summary = run.train_task(task, &["log.observations=false"]).finish();
        assert_eq!(summary.hashes(), expected.hashes());
        assert!(summary.log.bytes < expected.log.bytes, "{} bytes", summary.log.bytes);
        for what in [&["--verify"][..], &["--retrain"], &["--with", "reward.uncertainty=0.1"]] {
            let Output { status, stdout, stderr } = replay(&run, what);
            let [out, err] = [stdout, stderr].map(|text| String::from_utf8(text).unwrap());
            assert!(status.success(), "{task} {what:?}: {out}{err}");
            expect_no_restored_log(&run);
        }
        let out = run.path("full-log");
        let mut restore = run.program("goalward");
        restore.args(["log", "restore"]).arg(run.folder().path()).arg("--out").arg(&out);
        assert!(restore.output().unwrap().status.success());
        // The order of the records depends on the actors; nothing else may differ.
        assert_eq!(trajectories(&out, task), trajectories(&full.folder().log(), task));
    }
}

#[test]
fn an_episode_that_acts_otherwise_is_not_restored() {
    let run = TestRun::new(programs!());
    run.finish(&["log.observations=false"]);
    change_log(&run, |trajectory| {
        trajectory.full_hash ^= u64::from(trajectory.lane == 2 && trajectory.episode == 3);
    });
    for what in ["--verify", "--retrain"] {
        let Output { status, stderr, .. } = replay(&run, &[what]);
        let stderr = String::from_utf8_lossy(&stderr);
        assert_eq!(status.code(), Some(1), "{what}: {stderr}");
        assert!(stderr.contains("lane 2 episode 3"), "{what}: {stderr}");
    }
    expect_no_restored_log(&run);

    let out = run.path("full-log");
    fs::create_dir(&out).unwrap();
    fs::write(out.join("updates-00000.mcap"), "dear").unwrap();
    let arguments = ["log", "restore", "run", "--out", "full-log", "--force"];
    let (well, said) = run.goalward(&arguments);
    assert!(!well && said.contains("lane 2 episode 3"), "{said}");
    assert_eq!(fs::read_to_string(out.join("updates-00000.mcap")).unwrap(), "dear");
    assert_eq!(fs::read_dir(&out).unwrap().count(), 1);
}
