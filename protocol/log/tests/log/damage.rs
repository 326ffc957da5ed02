//! Cut, damaged and abandoned files: read up to the damage, repaired around it.

use std::fs;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use mcap_log::{
    Contents, Ending, FileReader, FileWriter, LogOptions, LogWriter, Record, Topic, info, repair,
};
use proptest::prelude::*;
use prost::Message;
use protocol::messages::RewardUpdate;

use crate::{layout, metadata, names, read, trajectory, write_file};

#[test]
fn a_file_cut_anywhere_gives_the_beginning_of_what_it_held() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("whole.mcap");
    let records = write_file(&path);
    let file = fs::read(&path).unwrap();
    let metadata_end = layout(&file)[1].1 + layout(&file)[1].2;
    let cut = folder.path().join("cut.mcap");
    proptest!(ProptestConfig::with_cases(64), |(share in 0.0..1.0f64, edge in 0..400usize)| {
        // Half of the cuts are anywhere in the file, half near its record boundaries.
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
    let damaged = folder.path().join("trajectories-00000.mcap");
    let records = write_file(&damaged);
    let file = fs::read(&damaged).unwrap();
    // Another file of the run, which knows the metadata.
    let updates = folder.path().join("updates-00000.mcap");
    let topics = Contents::Updates.topics();
    FileWriter::create(&updates, &metadata(), topics).unwrap().seal().unwrap();
    let chunks: Vec<_> = layout(&file).into_iter().filter(|&(kind, ..)| kind == 0x06).collect();
    let &(_, data_end, _) = layout(&file).iter().find(|&&(kind, ..)| kind == 0x0f).unwrap();
    // Most of the places are in the beginning and in the summary, which are small.
    let areas = [0..file.len(), 0..chunks[0].1, data_end..file.len()];
    let places = (prop::sample::select(areas.to_vec()), any::<prop::sample::Index>());
    proptest!(ProptestConfig::with_cases(192), |((area, place) in places, bit in 0..8u8)| {
        let at = area.start + place.index(area.len());
        let mut bytes = file.clone();
        bytes[at] ^= 1 << bit;
        fs::write(&damaged, &bytes).unwrap();
        let mut reader = match FileReader::open(&damaged) {
            Ok(reader) => reader,
            Err(error) => {
                prop_assert!(error.to_string().contains("expected format version"), "{}", error);
                return Ok(());
            }
        };
        let found: Vec<Record> = reader.by_ref().map(|entry| entry.unwrap().record).collect();
        let ending = reader.ending().unwrap().clone();
        prop_assert!(records.starts_with(&found), "wrong records");
        prop_assert!(ending.lost(), "byte {} bit {}: {}", at, bit, ending);
        // In a chunk's compressed data, which come after kind, length and header.
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
    // The chunk with the channels also has the first message.
    assert_eq!((repaired.kept[&Topic::Trajectory], repaired.lost), (999, 1), "{repaired}");
    assert_eq!(read(&path), (records[1..].to_vec(), Ending::Complete));
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
    let report = info(&active).unwrap().unwrap().to_string();
    assert!(report.contains("updates-00000.mcap.active: active"), "{report}");
    assert!(!report.contains('%'), "a file of next to nothing is no part of it: {report}");

    let repaired = repair(&active).unwrap();
    assert_eq!((repaired.lost, repaired.damage.len(), repaired.damaged), (0, 0, None));
    assert_eq!(names(folder.path()), ["updates-00000.mcap"]);
    assert_eq!(read(&path), (vec![Record::RewardUpdate(update)], Ending::Complete));
    let report = info(&path).unwrap().unwrap();
    assert_eq!((report.messages[&Topic::RewardUpdate], report.span_ns), (1, Some((5, 5))));
    assert!(report.to_string().contains("checksums correct; complete"), "{report}");

    let begun = folder.path().join("updates-00001.mcap.active");
    fs::write(&begun, &fs::read(&path).unwrap()[..20]).unwrap();
    let repaired = repair(&begun).unwrap();
    assert_eq!(repaired.sealed, None);
    assert_eq!(names(folder.path()), ["updates-00000.mcap", "updates-00001.mcap.active.damaged"]);
}

const CHILD_FOLDER: &str = "GOALWARD_TEST_LOG_FOLDER";

/// Not a test itself: the test below starts and kills it.
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
        .args(["--exact", "damage::write_until_killed", "--ignored"])
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
    // A kill can come while a chunk is being written.
    assert!(matches!(ending, Ending::Unsealed | Ending::Truncated { .. }), "{ending}");
    let lost = written.saturating_sub(records.len() as u64);
    assert!(lost * 5000 <= (1 << 20) + 2 * 5100, "{lost} of {written} trajectories lost");
    for (episode, record) in records.iter().enumerate() {
        assert!(*record == Record::Trajectory(trajectory(0, episode as u64, 5000).bytes));
    }
    let repaired = repair(&path).unwrap();
    assert_eq!(repaired.kept[&Topic::Trajectory] as usize, records.len());
    assert_eq!(read(&repaired.sealed.unwrap()).1, Ending::Complete);
}
