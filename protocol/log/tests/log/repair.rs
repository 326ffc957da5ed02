//! Repairs that die, and repairs of files that are still being written.

use std::fs::{self, File};
use std::path::Path;
use std::thread;
use std::time::Duration;

use mcap_log::{Contents, Ending, FileReader, FileWriter, info, is_being_written, repair};
use protocol::Error;

use crate::{layout, metadata, names, read, trajectory, write_file};

/// Writes a file with `episodes` trajectories and leaves it unsealed.
fn unsealed(path: &Path, episodes: u64) {
    let mut writer =
        FileWriter::create(path, &metadata(), Contents::Trajectories.topics()).unwrap();
    for episode in 0..episodes {
        writer.trajectory(&trajectory(0, episode, 5000), episode).unwrap();
    }
}

#[test]
fn a_file_that_is_written_is_not_repaired_and_has_lost_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("trajectories-00000.mcap");
    let active = folder.path().join("trajectories-00000.mcap.active");
    let elsewhere = folder.path().join("elsewhere");
    let mut writer =
        FileWriter::create(&path, &metadata(), Contents::Trajectories.topics()).unwrap();
    writer.trajectory(&trajectory(0, 1, 5000), 1).unwrap();
    writer.flush().unwrap();
    fs::hard_link(&active, &elsewhere).unwrap();
    for name in [&active, &elsewhere] {
        let error = repair(name).unwrap_err().to_string();
        assert!(error.contains("found one being written"), "{error}");
        let ending = info(name).unwrap().unwrap().ending;
        assert_eq!(ending, Ending::Unsealed, "{ending}");
    }
    let mut reader = FileReader::open(&active).unwrap();
    writer.trajectory(&trajectory(0, 2, 5000), 2).unwrap();
    writer.seal().unwrap();
    assert_eq!(reader.by_ref().count(), 1);
    assert_eq!(reader.ending(), Some(&Ending::Unsealed), "its writer went on");
    assert_eq!(read(&path).0.len(), 2);
}

#[test]
fn a_repair_waits_for_a_reader_that_asks_whether_the_file_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("trajectories-00000.mcap");
    let active = folder.path().join("trajectories-00000.mcap.active");
    unsealed(&path, 2);
    let reader = File::open(&active).unwrap();
    reader.lock_shared().unwrap();
    thread::scope(|scope| {
        scope.spawn(move || {
            thread::sleep(Duration::from_millis(5));
            drop(reader);
        });
        repair(&active).unwrap();
    });
    assert_eq!(read(&path).0.len(), 2);
}

#[test]
fn a_file_is_locked_however_often_somebody_asks() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("file.mcap");
    thread::scope(|scope| {
        let asking = scope.spawn(|| (0..50_000).filter(|_| is_being_written(&path)).count());
        while !asking.is_finished() {
            let mut writer = FileWriter::create(&path, &metadata(), &[]).unwrap();
            assert!(is_being_written(&path), "somebody else could remove it");
            writer.discard().unwrap();
        }
    });
}

#[test]
fn a_repair_that_died_before_it_removed_the_original_is_ended() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("trajectories-00000.mcap");
    let active = folder.path().join("trajectories-00000.mcap.active");
    for damaged in [false, true] {
        unsealed(&path, 1000);
        if damaged {
            let mut file = fs::read(&active).unwrap();
            let chunks: Vec<_> =
                layout(&file).into_iter().filter(|&(kind, ..)| kind == 0x06).collect();
            let (_, start, length) = chunks[chunks.len() / 2];
            file[start + length / 2] ^= 1;
            fs::write(&active, &file).unwrap();
        }
        let original = fs::read(&active).unwrap();
        let first = repair(&active).unwrap();
        fs::remove_file(first.damaged.unwrap_or_default()).ok();
        let sealed = fs::read(&path).unwrap();
        fs::write(&active, &original).unwrap();

        let again = repair(&active).unwrap();
        assert_eq!((again.kept, again.damage.len()), (first.kept, first.damage.len()));
        assert_eq!(fs::read(&path).unwrap(), sealed);
        assert!(!active.exists());
        match again.damaged {
            Some(kept) => assert_eq!(fs::read(kept).unwrap(), original),
            None => assert!(!damaged),
        }
        for name in names(folder.path()) {
            fs::remove_file(folder.path().join(name)).unwrap();
        }
    }
}

#[test]
fn another_file_under_the_sealed_name_is_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("trajectories-00000.mcap");
    let active = folder.path().join("trajectories-00000.mcap.active");
    unsealed(&path, 1000);
    let longer = fs::read(&active).unwrap();
    fs::remove_file(&active).unwrap();
    unsealed(&path, 900);
    repair(&active).unwrap();
    fs::write(&active, &longer).unwrap();
    let before = fs::read(&path).unwrap();
    let error = repair(&active).unwrap_err().to_string();
    assert!(error.contains("which has something else"), "{error}");
    // The sealed one is longer, or cut off.
    fs::remove_file(&active).unwrap();
    unsealed_beside(&path, &active, 800);
    assert!(repair(&active).is_err());
    fs::write(&path, &before[..before.len() / 2]).unwrap();
    assert!(repair(&active).is_err());
    assert_eq!(fs::read(&path).unwrap().len(), before.len() / 2);
    assert!(active.exists());
}

/// As [`unsealed`], while there is a file at `path`.
fn unsealed_beside(path: &Path, active: &Path, episodes: u64) {
    let other = path.with_file_name("other.mcap");
    unsealed(&other, episodes);
    fs::rename(other.with_extension("mcap.active"), active).unwrap();
}

#[test]
fn a_damaged_original_is_linked_aside_once() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("file.mcap");
    write_file(&path);
    let file = fs::read(&path).unwrap();
    let lost_its_end = &file[..layout(&file).last().unwrap().1];
    fs::write(&path, lost_its_end).unwrap();
    let ending = info(&path).unwrap().unwrap().ending;
    assert!(ending.lost() && ending.to_string().contains("its end is missing"), "{ending}");
    // A repair that died has already linked it.
    fs::hard_link(&path, folder.path().join("file.mcap.damaged")).unwrap();
    let repaired = repair(&path).unwrap();
    assert!(repaired.damage[0].contains("its end is missing"), "{repaired}");
    assert_eq!(names(folder.path()), ["file.mcap", "file.mcap.damaged"]);
    assert_eq!(fs::read(repaired.damaged.unwrap()).unwrap(), lost_its_end);
    assert_eq!(read(&path).1, Ending::Complete);
}

#[test]
fn what_died_before_it_was_sealed_is_recorded_anew() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("evaluation.mcap");
    unsealed(&path, 2);
    let error = FileWriter::create(&path, &metadata(), Contents::Trajectories.topics()).err();
    assert!(matches!(error, Some(Error::LogWrite { .. })), "{error:?}");
    let topics = Contents::Trajectories.topics();
    for episodes in 3..5 {
        let mut writer = FileWriter::create_anew(&path, &metadata(), topics).unwrap();
        assert!(
            FileWriter::create_anew(&path, &metadata(), topics).is_err(),
            "it is being written"
        );
        let before = path.exists().then(|| fs::read(&path).unwrap());
        for episode in 0..episodes {
            writer.trajectory(&trajectory(0, episode, 5000), episode).unwrap();
        }
        assert_eq!(path.exists().then(|| fs::read(&path).unwrap()), before);
        writer.seal().unwrap();
        assert_eq!(read(&path).0.len() as u64, episodes);
    }
    assert_eq!(names(folder.path()), ["evaluation.mcap"]);
}
