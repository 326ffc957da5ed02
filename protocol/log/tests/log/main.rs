//! The log whatever happens to it: what was written is read, or the loss is reported; nothing else is returned. This
//! file has round trips and foreign files. Crashes, cuts and flipped bits are in `damage.rs`, those before the first
//! record in `beginning.rs`, files that grow in `following.rs`, repairs that die in `repair.rs`, malicious files in
//! `hostile.rs`, rotation and resumption in `run.rs`.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

mod beginning;
mod damage;
mod following;
mod hostile;
mod repair;
mod run;

use std::fs;
use std::path::Path;

use bytes::Bytes;
use mcap_log::{
    Contents, Ending, Entry, FileReader, FileWriter, Kind, Metadata, Record, Topic, read_run,
    require_room,
};
use proptest::prelude::*;
use prost::Message;
use protocol::messages::{Checkpoint, PolicyUpdate, RewardUpdate, Score};
use protocol::trajectory::{Encoded, Source, Trajectory, TrajectoryKey};
use rand_chacha::rand_core::{Rng, SeedableRng};

fn metadata() -> Metadata {
    Metadata::new(Kind::Run, "navigation", 7).with("config", "task = \"navigation\"\n")
}

/// Returns an episode whose observations are noise, so that compression does not change its size.
fn trajectory(iteration: u64, episode: u64, bytes: usize) -> Encoded {
    let mut noise = rand_chacha::ChaCha8Rng::seed_from_u64(episode);
    let mut cells = vec![0; bytes];
    noise.fill_bytes(&mut cells);
    Encoded::encode(Trajectory {
        task: "navigation".to_owned(),
        iteration,
        lane: episode % 4,
        episode,
        cells: cells.into(),
        ..Trajectory::default()
    })
}

/// Writes a file of 1,000 trajectories of 5 kB in about 5 chunks. Returns the records.
fn write_file(path: &Path) -> Vec<Record> {
    let mut writer =
        FileWriter::create(path, &metadata(), Contents::Trajectories.topics()).unwrap();
    let mut records = Vec::new();
    for episode in 0..1000 {
        let trajectory = trajectory(episode / 100, episode, 5000);
        writer.trajectory(&trajectory, 1000 + episode).unwrap();
        records.push(Record::Trajectory(trajectory.bytes));
    }
    writer.seal().unwrap();
    records
}

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<_> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

/// Returns kind, start and length of the top-level records of a file.
fn layout(file: &[u8]) -> Vec<(u8, usize, usize)> {
    let mut records = Vec::new();
    let mut at = 8;
    while at + 9 <= file.len() {
        let length = u64::from_le_bytes(file[at + 1..at + 9].try_into().unwrap()) as usize;
        records.push((file[at], at, 9 + length));
        if file[at] == 0x02 {
            break;
        }
        at += 9 + length;
    }
    records
}

fn read(path: &Path) -> (Vec<Record>, Ending) {
    let mut reader = FileReader::open(path).unwrap();
    let records = reader.by_ref().map(|entry| entry.unwrap().record).collect();
    (records, reader.ending().unwrap().clone())
}

fn bytes(longest: usize) -> impl Strategy<Value = Bytes> {
    prop::collection::vec(any::<u8>(), 0..longest).prop_map(Bytes::from)
}

fn any_record() -> impl Strategy<Value = (Topic, Vec<u8>)> {
    let numbers = || {
        prop::collection::vec(
            any::<u32>().prop_map(|bits| f32::from_bits(bits & 0x7f7f_ffff)),
            0..50,
        )
    };
    let trajectory = (bytes(3000), bytes(40), any::<u64>(), any::<bool>(), ".{0,9}").prop_map(
        |(cells, values, lane, success, task)| {
            let evaluation = lane % 2 == 1;
            let source = if evaluation { Source::Evaluation } else { Source::Training } as i32;
            let ours =
                Trajectory { task, source, cells, values, lane, success, ..Trajectory::default() };
            (Topic::of(&ours), ours.encode_to_vec())
        },
    );
    let score = (any::<u64>(), numbers(), numbers()).prop_map(|(lane, rewards, proximity)| {
        (Topic::Score, Score { lane, rewards, proximity, ..Score::default() }.encode_to_vec())
    });
    let policy = (any::<u64>(), -1e300..1e300, prop::collection::vec(any::<u64>(), 0..9)).prop_map(
        |(iteration, policy_loss, lanes)| {
            let key = |lane| TrajectoryKey { lane, episode: lane / 2, hash: !lane };
            let consumed = lanes.into_iter().map(key).collect();
            let update =
                PolicyUpdate { iteration, policy_loss, consumed, ..PolicyUpdate::default() };
            (Topic::PolicyUpdate, update.encode_to_vec())
        },
    );
    let reward = (any::<u64>(), -1e300..1e300, ".{0,64}").prop_map(
        |(iteration, agent_loss, weights_sha256)| {
            let update =
                RewardUpdate { iteration, agent_loss, weights_sha256, ..RewardUpdate::default() };
            (Topic::RewardUpdate, update.encode_to_vec())
        },
    );
    let checkpoint = (any::<u64>(), ".{0,64}").prop_map(|(iteration, path)| {
        (Topic::Checkpoint, Checkpoint { iteration, path, ..Checkpoint::default() }.encode_to_vec())
    });
    prop_oneof![trajectory, score, policy, reward, checkpoint]
}

fn encode(record: &Record) -> (Topic, Vec<u8>) {
    match record {
        Record::Trajectory(bytes) => (Topic::Trajectory, bytes.to_vec()),
        Record::EvaluationTrajectory(bytes) => (Topic::EvaluationTrajectory, bytes.to_vec()),
        Record::Score(score) => (Topic::Score, score.encode_to_vec()),
        Record::PolicyUpdate(update) => (Topic::PolicyUpdate, update.encode_to_vec()),
        Record::RewardUpdate(update) => (Topic::RewardUpdate, update.encode_to_vec()),
        Record::Checkpoint(checkpoint) => (Topic::Checkpoint, checkpoint.encode_to_vec()),
        Record::Scene(scene) => (Topic::Scene, scene.encode_to_vec()),
        Record::Picture(picture) => (Topic::Picture, picture.encode_to_vec()),
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn every_message_comes_back_as_it_was_written(
        records in prop::collection::vec((any_record(), any::<bool>()), 0..60),
    ) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file.mcap");
        let mut writer = FileWriter::create(&path, &metadata(), &Topic::ALL).unwrap();
        for (time, ((topic, bytes), flush)) in records.iter().enumerate() {
            writer.message(*topic, time as u64, bytes).unwrap();
            if *flush {
                writer.flush().unwrap();
            }
        }
        writer.seal().unwrap();
        let mut reader = FileReader::open(&path).unwrap();
        prop_assert_eq!(reader.metadata(), &metadata());
        let entries: Vec<Entry> = reader.by_ref().map(Result::unwrap).collect();
        prop_assert_eq!(reader.ending(), Some(&Ending::Complete));
        prop_assert_eq!(entries.len(), records.len());
        for (time, (entry, (expected, _))) in entries.iter().zip(&records).enumerate() {
            prop_assert_eq!(&encode(&entry.record), expected);
            prop_assert_eq!(entry.log_time_ns, time as u64);
        }
    }
}

#[test]
fn the_metadata_is_the_first_record() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("file.mcap");
    write_file(&path);
    let file = fs::read(&path).unwrap();
    let kinds: Vec<u8> = layout(&file).iter().map(|&(kind, ..)| kind).collect();
    assert_eq!(kinds[..3], [0x01, 0x0c, 0x06], "header, metadata, then chunks");
    assert_eq!(FileReader::open(&path).unwrap().metadata().get("config"), metadata().get("config"));
}

#[test]
fn files_of_others_are_refused_in_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("file.mcap");
    let refusal = |bytes: &[u8]| {
        fs::write(&path, bytes).unwrap();
        let message = FileReader::open(&path).err().unwrap().to_string();
        assert!(message.contains("file.mcap") && !message.contains('\n'), "{message}");
        message
    };
    let message = refusal(b"not at all");
    assert!(message.contains("expected an MCAP file"), "{message}");

    fs::remove_file(&path).unwrap();
    write_file(&path);
    let ours = fs::read(&path).unwrap();
    let mut foreign = ours[..layout(&ours)[1].1].to_vec();
    foreign.extend([0x0f, 4, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
    let message = refusal(&foreign);
    assert!(message.contains("not recorded by goalward: expected metadata"), "{message}");

    let newer = metadata().with("format_version", 2).with("goalward_version", "9.9");
    fs::remove_file(&path).unwrap();
    FileWriter::create(&path, &newer, &[]).unwrap().seal().unwrap();
    let message = FileReader::open(&path).err().unwrap().to_string();
    assert!(message.contains("expected format version 1 or older, found 2"), "{message}");
    assert!(message.contains("9.9"), "{message}");

    let message = FileReader::open(&folder.path().join("absent")).err().unwrap().to_string();
    assert!(message.contains("absent") && message.contains("cannot open"), "{message}");
    let message = read_run(folder.path()).err().unwrap().to_string();
    assert!(message.contains("expected files such as"), "{message}");
}

#[test]
fn nothing_is_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("file.mcap");
    let create = || FileWriter::create(&path, &metadata(), &[Topic::Trajectory]);
    let mut first = create().unwrap();
    let message = create().err().unwrap().to_string();
    assert!(message.contains("file.mcap.active: cannot create the file"), "{message}");
    first.seal().unwrap();
    first.seal().unwrap();
    let message = create().err().unwrap().to_string();
    assert!(message.contains("file.mcap: cannot create the file"), "{message}");
    let message = first.message(Topic::Score, 0, b"").unwrap_err().to_string();
    assert!(message.contains("/proximity/score"), "{message}");
}

#[test]
fn room_on_the_disk_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    require_room(folder.path(), 1).unwrap();
    let message = require_room(folder.path(), 1 << 60).unwrap_err().to_string();
    assert!(message.contains("no room on the disk: expected 1099511627776 MiB"), "{message}");
}

#[test]
fn the_index_says_when_the_first_message_was() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("file.mcap");
    let mut writer = FileWriter::create(&path, &metadata(), &Topic::ALL).unwrap();
    let begun = 1_700_000_000_000_000_000;
    for time in 0..5 {
        writer.message(Topic::Checkpoint, begun + time, b"").unwrap();
    }
    writer.seal().unwrap();
    let summary = mcap::Summary::read(&std::fs::read(&path).unwrap()).unwrap().unwrap();
    let starts: Vec<u64> =
        summary.chunk_indexes.iter().map(|chunk| chunk.message_start_time).collect();
    assert_eq!(starts, [begun, begun + 1], "viewers take the least of these as the beginning");
}
