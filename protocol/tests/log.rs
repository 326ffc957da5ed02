//! The log under everything that happens to logs: crashes, cuts, flipped bits, resumption, others'
//! files. What was written is read, or the loss is named; nothing else comes out.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use bytes::Bytes;
use proptest::prelude::*;
use prost::Message;
use protocol::log::{
    Contents, Ending, Entry, FileReader, FileWriter, Kind, LogOptions, LogWriter, Metadata, Record,
    Topic, info, log_files, read_contents, read_run, repair, require_room,
};
use protocol::messages::{Checkpoint, PolicyUpdate, RewardUpdate, Score};
use protocol::trajectory::{Encoded, Source, Trajectory, TrajectoryKey};

fn metadata() -> Metadata {
    Metadata::new(Kind::Run, "navigation", 7).with("config", "task = \"navigation\"\n")
}

/// An episode with so much noise in its observations that compression leaves its size.
fn trajectory(iteration: u64, episode: u64, bytes: usize) -> Encoded {
    let noise =
        |place: u64| (place + 1).wrapping_mul(episode + 77).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let cells: Vec<u8> = (0..bytes as u64).map(|place| (noise(place) >> 56) as u8).collect();
    Encoded::encode(Trajectory {
        task: "navigation".to_owned(),
        iteration,
        lane: episode % 4,
        episode,
        cells: cells.into(),
        ..Trajectory::default()
    })
}

fn score(iteration: u64, episode: u64) -> Score {
    Score { iteration, lane: episode % 4, episode, rewards: vec![0.5; 20], ..Score::default() }
}

/// Writes a file of 1,000 trajectories of 5 kB; about 5 chunks. Gives the records.
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

fn read(path: &Path) -> (Vec<Record>, Ending) {
    let mut reader = FileReader::open(path).unwrap();
    let records = reader.by_ref().map(|entry| entry.unwrap().record).collect();
    (records, reader.ending().unwrap().clone())
}

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<_> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

/// Kind, start and length of the outermost records of a file.
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
fn a_file_cut_anywhere_gives_the_beginning_of_what_it_held() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("whole.mcap");
    let records = write_file(&path);
    let file = fs::read(&path).unwrap();
    let metadata_end = layout(&file)[1].1 + layout(&file)[1].2;
    let cut = folder.path().join("cut.mcap");
    proptest!(ProptestConfig::with_cases(64), |(share in 0.0..1.0f64, edge in 0..400usize)| {
        // Half of the cuts in the file, half near its record boundaries.
        let boundaries = layout(&file);
        let (_, start, _) = boundaries[edge % boundaries.len()];
        let at = if edge % 2 == 0 { (share * file.len() as f64) as usize } else { start + edge % 12 };
        let at = at.min(file.len() - 1);
        fs::write(&cut, &file[..at]).unwrap();
        if at < metadata_end {
            let error = FileReader::open(&cut).err().unwrap().to_string();
            prop_assert!(error.contains("cut.mcap"), "{}", error);
            prop_assert!(error.contains("expected metadata"), "{}", error);
            return Ok(());
        }
        let (found, ending) = read(&cut);
        prop_assert!(records.starts_with(&found));
        match ending {
            Ending::Unsealed => {}
            Ending::Truncated { offset, lost_bytes } => {
                prop_assert!(boundaries.iter().any(|&(_, start, _)| start as u64 == offset));
                prop_assert_eq!(offset + lost_bytes, at as u64);
            }
            ending => prop_assert!(false, "{}", ending),
        }
    });
}

#[test]
fn a_flipped_bit_is_found_wherever_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("whole.mcap");
    let records = write_file(&path);
    let file = fs::read(&path).unwrap();
    let damaged = folder.path().join("damaged.mcap");
    let chunks: Vec<_> = layout(&file).into_iter().filter(|&(kind, ..)| kind == 0x06).collect();
    proptest!(ProptestConfig::with_cases(96), |(place in any::<prop::sample::Index>(), bit in 0..8u8)| {
        let at = place.index(file.len());
        let mut bytes = file.clone();
        bytes[at] ^= 1 << bit;
        fs::write(&damaged, &bytes).unwrap();
        let Ok(mut reader) = FileReader::open(&damaged) else { return Ok(()) };
        let found: Vec<Record> = reader.by_ref().map(|entry| entry.unwrap().record).collect();
        let ending = reader.ending().unwrap().clone();
        prop_assert!(records.starts_with(&found), "wrong records");
        prop_assert!(ending.lost(), "byte {} bit {}: {}", at, bit, ending);
        // In a chunk's compressed data: behind kind, length and header.
        let chunk = chunks.iter().find(|&&(_, start, length)| (start + 60..start + length).contains(&at));
        if let Some(&(_, start, _)) = chunk {
            let Ending::Corrupt { offset, lost_records, .. } = ending else {
                return Err(TestCaseError::fail(format!("{ending}")));
            };
            prop_assert_eq!(offset, start as u64);
            prop_assert_eq!(lost_records, Some((records.len() - found.len()) as u64));
        }
    });
}

#[test]
fn repair_keeps_what_is_intact_on_both_sides_of_the_damage() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("trajectories-00000.mcap");
    let records = write_file(&path);
    let mut file = fs::read(&path).unwrap();
    let chunks: Vec<_> = layout(&file).into_iter().filter(|&(kind, ..)| kind == 0x06).collect();
    let (_, start, length) = chunks[chunks.len() / 2];
    file[start + length / 2] ^= 1;
    fs::write(&path, &file).unwrap();
    let before = read(&path).0.len();

    let repaired = repair(&path).unwrap();
    let kept = repaired.kept[&Topic::Trajectory] as usize;
    assert!(kept > before && kept < records.len(), "{repaired}");
    assert_eq!(repaired.lost as usize, records.len() - kept, "{repaired}");
    assert!(repaired.damage[0].contains(&format!("byte {start}")), "{repaired}");
    assert_eq!(
        names(folder.path()),
        ["trajectories-00000.mcap", "trajectories-00000.mcap.damaged"]
    );
    let (found, ending) = read(&path);
    assert_eq!(ending, Ending::Complete);
    assert_eq!(found.len(), kept);
    assert!(found.iter().all(|record| records.contains(record)));
    assert_eq!(fs::read(repaired.damaged.unwrap()).unwrap(), file);
    assert_eq!(FileReader::open(&path).unwrap().metadata(), &metadata());

    let again = repair(&path).unwrap();
    assert!(again.damage.is_empty() && again.kept[&Topic::Trajectory] as usize == kept, "{again}");
    assert_eq!(names(folder.path()).len(), 2);
}

#[test]
fn repair_reads_channels_from_the_end_when_the_beginning_is_damaged() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("file.mcap");
    let records = write_file(&path);
    let mut file = fs::read(&path).unwrap();
    let &(_, start, _) = layout(&file).iter().find(|&&(kind, ..)| kind == 0x06).unwrap();
    file[start + 100] ^= 1;
    fs::write(&path, &file).unwrap();
    let repaired = repair(&path).unwrap();
    assert_eq!((repaired.kept[&Topic::Trajectory], repaired.lost), (1000, 0), "{repaired}");
    assert_eq!(read(&path), (records, Ending::Complete));
}

#[test]
fn an_unsealed_file_reads_and_is_sealed_by_repair() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("updates-00000.mcap");
    let active = folder.path().join("updates-00000.mcap.active");
    let mut writer = FileWriter::create(&path, &metadata(), Contents::Updates.topics()).unwrap();
    let update = RewardUpdate { iteration: 3, ..RewardUpdate::default() };
    writer.message(Topic::RewardUpdate, 5, &update.encode_to_vec()).unwrap();
    drop(writer);
    assert_eq!(names(folder.path()), ["updates-00000.mcap.active"]);
    assert_eq!(read(&active), (vec![Record::RewardUpdate(update.clone())], Ending::Unsealed));
    assert!(info(&active).unwrap().to_string().contains("updates-00000.mcap.active: active"));

    let repaired = repair(&active).unwrap();
    assert_eq!((repaired.lost, repaired.damage.len(), repaired.damaged), (0, 0, None));
    assert_eq!(names(folder.path()), ["updates-00000.mcap"]);
    assert_eq!(read(&path), (vec![Record::RewardUpdate(update)], Ending::Complete));
    let report = info(&path).unwrap();
    assert_eq!((report.messages[&Topic::RewardUpdate], report.span_ns), (1, Some((5, 5))));
    assert!(report.to_string().contains("checksums right; complete"), "{report}");

    let begun = folder.path().join("updates-00001.mcap.active");
    fs::write(&begun, &fs::read(&path).unwrap()[..20]).unwrap();
    let repaired = repair(&begun).unwrap();
    assert_eq!(repaired.sealed, None);
    assert_eq!(names(folder.path()), ["updates-00000.mcap", "updates-00001.mcap.active.damaged"]);
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
fn files_rotate_and_every_sitting_has_its_own() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("log");
    let options = LogOptions { rotate_bytes: 1 << 20 };
    let mut writer = LogWriter::create(&log, &metadata(), options).unwrap();
    for episode in 0..600 {
        writer.trajectory(&trajectory(0, episode, 5000)).unwrap();
    }
    // The second sitting comes after a crash of the first, and does not touch its files.
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
    assert_eq!((run.repeated(), run.endings().len()), (0, 6));
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
    assert_eq!(run.repeated(), 2 * 4 + 2);
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

const CHILD_FOLDER: &str = "GOALWARD_TEST_LOG_FOLDER";

/// Not a test: what the test below starts and kills.
#[test]
#[ignore = "runs as a child of a_killed_writer_loses_one_chunk_at_most"]
fn write_until_killed() {
    let Some(folder) = std::env::var_os(CHILD_FOLDER).map(PathBuf::from) else { return };
    let mut writer =
        LogWriter::create(&folder.join("log"), &metadata(), LogOptions::default()).unwrap();
    for episode in 0.. {
        writer.trajectory(&trajectory(0, episode, 5000)).unwrap();
        fs::write(folder.join("written.new"), episode.to_string()).unwrap();
        fs::rename(folder.join("written.new"), folder.join("written")).unwrap();
    }
}

#[test]
fn a_killed_writer_loses_one_chunk_at_most() {
    let folder = tempfile::tempdir().unwrap();
    let mut child = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "write_until_killed", "--ignored"])
        .env(CHILD_FOLDER, folder.path())
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let written = || -> u64 {
        let text = fs::read_to_string(folder.path().join("written"));
        text.ok().and_then(|text| text.parse().ok()).unwrap_or(0)
    };
    let start = Instant::now();
    while written() < 700 && start.elapsed() < Duration::from_secs(60) {
        std::thread::sleep(Duration::from_millis(5));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    let written = written() + 1;
    assert!(written > 700, "the child wrote {written} trajectories in a minute");

    let path = folder.path().join("log/trajectories-00000.mcap.active");
    let (records, ending) = read(&path);
    assert_eq!(ending, Ending::Unsealed);
    let lost = written.saturating_sub(records.len() as u64);
    assert!(lost * 5000 <= (1 << 20) + 2 * 5100, "{lost} of {written} trajectories lost");
    for (episode, record) in records.iter().enumerate() {
        assert!(*record == Record::Trajectory(trajectory(0, episode as u64, 5000).bytes));
    }
    let repaired = repair(&path).unwrap();
    assert_eq!(repaired.kept[&Topic::Trajectory] as usize, records.len());
    assert_eq!(read(&repaired.sealed.unwrap()).1, Ending::Complete);
}
