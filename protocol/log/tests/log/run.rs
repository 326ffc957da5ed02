//! A run's folder: rotation, resumption, and what was recorded twice.

use std::fs;
use std::ops::Range;

use mcap_log::{
    Contents, FileWriter, Kind, LogOptions, LogWriter, Metadata, Record, Topic, log_files,
    read_contents, read_run,
};
use prost::Message;
use protocol::messages::{Checkpoint, PolicyUpdate, RewardUpdate, Score};
use protocol::trajectory::Trajectory;

use crate::{metadata, names, trajectory};

fn score(iteration: u64, episode: u64) -> Score {
    Score { iteration, lane: episode % 4, episode, rewards: vec![0.5; 20], ..Score::default() }
}

#[test]
fn files_rotate_and_every_sitting_has_its_own() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("log");
    let options = LogOptions { rotate_bytes: 1 << 20, ..LogOptions::default() };
    let mut writer = LogWriter::create(&log, &metadata(), options).unwrap();
    for episode in 0..600 {
        writer.trajectory(&trajectory(0, episode, 5000)).unwrap();
    }
    // The second start comes after a crash of the first, and does not touch its files.
    drop(writer);
    assert_eq!(
        names(&log),
        [
            "trajectories-00000.mcap",
            "trajectories-00001.mcap",
            "trajectories-00002.mcap.active",
            "updates-00000.mcap.active",
        ]
    );
    let before = fs::read(log.join("trajectories-00002.mcap.active")).unwrap();
    let mut writer = LogWriter::create(&log, &metadata(), options).unwrap();
    writer.trajectory(&trajectory(0, 600, 5000)).unwrap();
    writer.finish().unwrap();
    assert_eq!(fs::read(log.join("trajectories-00002.mcap.active")).unwrap(), before);
    let files = log_files(&log).unwrap();
    let found: Vec<_> =
        files.iter().map(|file| (file.contents, file.number, file.active)).collect();
    let (trajectories, updates) = (Contents::Trajectories, Contents::Updates);
    let expected = [
        (trajectories, 0, false),
        (trajectories, 1, false),
        (trajectories, 2, true),
        (trajectories, 3, false),
        (updates, 0, true),
        (updates, 1, false),
    ];
    assert_eq!(found, expected);
    let sizes: u64 =
        files.iter().rev().take(3).map(|file| file.path.metadata().unwrap().len()).sum();
    assert!(writer.bytes_written() > 5000 && writer.bytes_written() < sizes);

    let mut run = read_run(&log).unwrap();
    let episodes: Vec<u64> = run
        .by_ref()
        .map(|entry| match entry.unwrap().record {
            Record::Trajectory(bytes) => Trajectory::decode(bytes).unwrap().episode,
            other => panic!("{other:?}"),
        })
        .collect();
    assert_eq!(episodes, (0..=600).collect::<Vec<_>>());
    assert_eq!((run.left_out(), run.endings().len()), (0, 6));
}

#[test]
fn what_was_recorded_twice_is_read_once() {
    let folder = tempfile::tempdir().unwrap();
    let update =
        |iteration, rollout_s| PolicyUpdate { iteration, rollout_s, ..PolicyUpdate::default() };
    let offline = RewardUpdate { seconds: 9.0, ..RewardUpdate::default() };
    let sit = |iterations: std::ops::Range<u64>, rollout_s: f64| {
        let mut writer =
            LogWriter::create(folder.path(), &metadata(), LogOptions::default()).unwrap();
        writer.reward_update(&offline).unwrap();
        for iteration in iterations {
            writer.trajectory(&trajectory(iteration, iteration, 100)).unwrap();
            writer.score(&score(iteration, iteration)).unwrap();
            writer.policy_update(&update(iteration, rollout_s)).unwrap();
            let online =
                RewardUpdate { iteration, model_version: iteration + 1, ..offline.clone() };
            writer.reward_update(&online).unwrap();
        }
        let checkpoint = Checkpoint { iteration: 2, ..Checkpoint::default() };
        writer.checkpoint(&checkpoint).unwrap();
        writer.finish().unwrap();
    };
    sit(0..4, 1.0);
    sit(2..6, 2.0);
    let mut run = read_run(folder.path()).unwrap();
    let records: Vec<Record> = run.by_ref().map(|entry| entry.unwrap().record).collect();
    // Two iterations of four records, the offline training and the checkpoint.
    assert_eq!(run.left_out(), 2 * 4 + 2);
    assert_eq!(records.len(), 6 * 4 + 2);
    let updates: Vec<(u64, f64)> = records
        .iter()
        .filter_map(|record| match record {
            Record::PolicyUpdate(update) => Some((update.iteration, update.rollout_s)),
            _ => None,
        })
        .collect();
    assert_eq!(updates, [(0, 1.0), (1, 1.0), (2, 2.0), (3, 2.0), (4, 2.0), (5, 2.0)]);
    let place = |wanted: &Record| records.iter().position(|record| record == wanted).unwrap();
    let learned = place(&Record::PolicyUpdate(Box::new(update(5, 2.0))));
    assert!(
        place(&Record::Score(score(5, 5))) < learned,
        "an update is behind what it learned from"
    );

    let updates = read_contents(folder.path(), Contents::Updates).unwrap();
    assert_eq!(updates.count(), 6 * 2 + 2);
}

#[test]
fn what_going_back_undid_does_not_come_ahead_of_what_is_done_again() {
    let folder = tempfile::tempdir().unwrap();
    let writer = || LogWriter::create(folder.path(), &metadata(), LogOptions::default()).unwrap();
    let iterate = |writer: &mut LogWriter, iteration: u64| {
        writer.trajectory(&trajectory(iteration, iteration, 100)).unwrap();
        writer.score(&score(iteration, iteration)).unwrap();
        writer.policy_update(&PolicyUpdate { iteration, ..PolicyUpdate::default() }).unwrap();
        writer.reward_update(&RewardUpdate { iteration, ..RewardUpdate::default() }).unwrap();
    };
    let mut first = writer();
    (0..4).for_each(|iteration| iterate(&mut first, iteration));
    first.checkpoint(&Checkpoint { iteration: 3, ..Checkpoint::default() }).unwrap();
    first.finish().unwrap();
    let mut second = writer();
    iterate(&mut second, 1);
    second.trajectory(&trajectory(2, 2, 100)).unwrap();
    second.finish().unwrap();

    let mut run = read_run(folder.path()).unwrap();
    let read: Vec<(&str, u64)> = run
        .by_ref()
        .map(|entry| match entry.unwrap().record {
            Record::Trajectory(bytes) => ("batch", Trajectory::decode(bytes).unwrap().iteration),
            Record::Score(score) => ("score", score.iteration),
            Record::PolicyUpdate(update) => ("policy", update.iteration),
            Record::RewardUpdate(update) => ("reward", update.iteration),
            Record::Checkpoint(checkpoint) => ("checkpoint", checkpoint.iteration),
            other => panic!("{other:?}"),
        })
        .collect();
    let whole =
        |iteration| ["batch", "score", "policy", "reward"].map(|record| (record, iteration));
    let expected = [&whole(0)[..], &[("checkpoint", 3)], &whole(1), &[("batch", 2)]].concat();
    assert_eq!(read, expected);
    assert_eq!(run.left_out(), 3 * 4);
    let updates = read_contents(folder.path(), Contents::Updates).unwrap();
    assert_eq!(updates.count(), 2 * 2 + 1, "also told from updates alone");
}

#[test]
fn a_sitting_comes_behind_the_earlier_ones_whatever_the_clock_says() {
    const YEAR_2100_NS: u64 = 4_102_444_800_000_000_000;
    for is_sealed in [true, false] {
        let folder = tempfile::tempdir().unwrap();
        let create = |name: &str, contents: Contents| {
            FileWriter::create(&folder.path().join(name), &metadata(), contents.topics()).unwrap()
        };
        let mut trajectories = create("trajectories-00000.mcap", Contents::Trajectories);
        let mut updates = create("updates-00000.mcap", Contents::Updates);
        let update = |iteration| PolicyUpdate { iteration, ..PolicyUpdate::default() };
        for iteration in 0..3 {
            let now_ns = YEAR_2100_NS + 2 * iteration;
            trajectories.trajectory(&trajectory(iteration, iteration, 100), now_ns).unwrap();
            let bytes = update(iteration).encode_to_vec();
            updates.message(Topic::PolicyUpdate, now_ns + 1, &bytes).unwrap();
        }
        if is_sealed {
            trajectories.seal().unwrap();
            updates.seal().unwrap();
        }
        drop((trajectories, updates));

        let sit = |iterations: Range<u64>| {
            let options = LogOptions::default();
            let mut writer = LogWriter::create(folder.path(), &metadata(), options).unwrap();
            for iteration in iterations {
                writer.trajectory(&trajectory(iteration, iteration, 100)).unwrap();
                writer.policy_update(&update(iteration)).unwrap();
            }
            writer.finish().unwrap();
        };
        let read = || {
            let mut run = read_run(folder.path()).unwrap();
            let iteration = |record: Record| match record {
                Record::Trajectory(bytes) => Trajectory::decode(bytes).unwrap().iteration,
                Record::PolicyUpdate(update) => update.iteration,
                other => panic!("{other:?}"),
            };
            let records = run.by_ref().map(|entry| iteration(entry.unwrap().record));
            (records.collect::<Vec<u64>>(), run.left_out())
        };
        let in_turns = |iterations: Range<u64>| -> Vec<u64> {
            iterations.flat_map(|number| [number; 2]).collect()
        };
        sit(3..6);
        assert_eq!(read(), (in_turns(0..6), 0), "nothing was undone");
        sit(4..5);
        assert_eq!(read(), (in_turns(0..5), 4), "4 was done again, 5 not yet");
    }
}

#[test]
fn a_folder_with_the_files_of_two_runs_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    for seed in [1, 2] {
        let metadata = Metadata::new(Kind::Run, "navigation", seed);
        let options = LogOptions::default();
        LogWriter::create(folder.path(), &metadata, options).unwrap().finish().unwrap();
    }
    let message = read_run(folder.path()).err().unwrap().to_string();
    assert!(message.contains("expected seed 1") && message.contains("found 2"), "{message}");
}

#[test]
fn sittings_may_differ_in_what_changes_no_result() {
    let folder = tempfile::tempdir().unwrap();
    let sit = |setting: &str| {
        let metadata = metadata().with("config", setting);
        let options = LogOptions::default();
        LogWriter::create(folder.path(), &metadata, options).unwrap().finish().unwrap();
    };
    sit("ppo.clip = 0.2\nresources.actors = 2");
    sit("ppo.clip = 0.2\nresources.actors = 3");
    assert_eq!(read_run(folder.path()).unwrap().count(), 0);
    sit("ppo.clip = 0.125\nresources.actors = 2");
    let message = read_run(folder.path()).err().unwrap().to_string();
    assert!(message.contains("expected ppo.clip = 0.2 as in"), "{message}");
    assert!(message.ends_with("found 0.125"), "{message}");
}

#[test]
fn a_run_is_read_while_it_is_written_and_sealed() {
    let folder = tempfile::tempdir().unwrap();
    let mut writer = LogWriter::create(folder.path(), &metadata(), LogOptions::default()).unwrap();
    writer.trajectory(&trajectory(0, 0, 100)).unwrap();
    writer.checkpoint(&Checkpoint::default()).unwrap();
    writer.flush().unwrap();
    writer.trajectory(&trajectory(0, 1, 100)).unwrap();
    assert_eq!(read_run(folder.path()).unwrap().count(), 2);
    writer.sync().unwrap();
    let run = read_run(folder.path()).unwrap();
    writer.trajectory(&trajectory(0, 2, 100)).unwrap();
    writer.finish().unwrap();
    writer.finish().unwrap();
    writer.flush().unwrap();
    assert_eq!(run.map(Result::unwrap).count(), 3);
    assert!(writer.trajectory(&trajectory(0, 3, 100)).is_err());
    assert_eq!(read_run(folder.path()).unwrap().count(), 4);
    assert_eq!(names(folder.path()), ["trajectories-00000.mcap", "updates-00000.mcap"]);
}
