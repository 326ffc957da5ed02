//! Reads files while they grow, and finds records again by their offsets.

use std::fs;

use mcap_log::{Contents, Ending, Entry, FileReader, FileWriter, Record, repair};

use crate::{layout, metadata, trajectory, write_file};

/// Returns the remaining records of a reader.
fn rest(reader: &mut FileReader) -> Vec<Record> {
    reader.by_ref().map(|entry| entry.unwrap().record).collect()
}

#[test]
fn a_file_that_grows_is_read_on_until_it_is_sealed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("trajectories-00000.mcap");
    let topics = Contents::Trajectories.topics();
    let mut writer = FileWriter::create(&path, &metadata(), topics).unwrap();
    let mut written = Vec::new();
    let mut write = |writer: &mut FileWriter, episodes| {
        for episode in episodes {
            let trajectory = trajectory(0, episode, 5000);
            writer.trajectory(&trajectory, 1000 + episode).unwrap();
            written.push(Record::Trajectory(trajectory.bytes));
        }
        writer.flush().unwrap();
        written.len()
    };
    let mut count = write(&mut writer, 0..300);
    let mut reader =
        FileReader::open(&folder.path().join("trajectories-00000.mcap.active")).unwrap();
    let mut found = rest(&mut reader);
    assert_eq!((found.len(), reader.ending()), (count, Some(&Ending::Unsealed)));
    reader.go_on().unwrap();
    assert!(rest(&mut reader).is_empty(), "nothing is new");

    count = write(&mut writer, 300..301);
    reader.go_on().unwrap();
    found.extend(rest(&mut reader));
    assert_eq!(found.len(), count);

    write(&mut writer, 301..900);
    writer.seal().unwrap();
    reader.go_on().unwrap();
    found.extend(rest(&mut reader));
    assert_eq!(reader.ending(), Some(&Ending::Complete));
    assert!(found == written);
    reader.go_on().unwrap();
    assert!(rest(&mut reader).is_empty(), "a sealed file has an end");
}

#[test]
fn a_file_that_another_one_has_replaced_is_not_read_on() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("trajectories-00000.mcap");
    let active = folder.path().join("trajectories-00000.mcap.active");
    let topics = Contents::Trajectories.topics();
    let mut writer = FileWriter::create(&path, &metadata(), topics).unwrap();
    for episode in 0..3 {
        writer.trajectory(&trajectory(0, episode, 5000), episode).unwrap();
        writer.flush().unwrap();
    }
    let mut reader = FileReader::open(&active).unwrap();
    assert_eq!(rest(&mut reader).len(), 3);
    // The writer dies, and the file is repaired.
    writer.trajectory(&trajectory(0, 3, 5000), 3).unwrap();
    drop(writer);
    assert!(reader.go_on().unwrap() && rest(&mut reader).len() == 1);
    repair(&active).unwrap();
    assert!(!reader.go_on().unwrap(), "the repaired file is another one");
    assert!(rest(&mut reader).is_empty() && !reader.go_on().unwrap());

    let mut reader = FileReader::open(&path).unwrap();
    assert_eq!(rest(&mut reader).len(), 4);
    assert!(reader.go_on().unwrap());
    let other = folder.path().join("other");
    fs::copy(&path, &other).unwrap();
    fs::rename(&other, &path).unwrap();
    assert!(!reader.go_on().unwrap(), "nor is one that was sealed");
}

#[test]
fn a_record_is_found_again_where_it_lies() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("whole.mcap");
    write_file(&path);
    let mut reader = FileReader::open(&path).unwrap();
    let mut places: Vec<(u64, Entry)> = Vec::new();
    while let Some(entry) = reader.next() {
        places.push((reader.offset(), entry.unwrap()));
    }
    let offsets: Vec<u64> = places.iter().map(|(offset, _)| *offset).collect();
    assert!(offsets.is_sorted() && offsets[0] < offsets[999]);
    for (offset, entry) in places.iter().step_by(97) {
        let found = reader.entries_at(*offset).unwrap();
        assert!(found.contains(entry), "byte {offset}");
    }

    let begins_nowhere = reader.entries_at(offsets[0] + 1).unwrap_err().to_string();
    assert!(begins_nowhere.contains(&format!("byte {}", offsets[0] + 1)), "{begins_nowhere}");
    let mut file = fs::read(&path).unwrap();
    let (_, start, length) = layout(&file).into_iter().find(|&(kind, ..)| kind == 0x06).unwrap();
    file[start + length / 2] ^= 1;
    fs::write(&path, &file).unwrap();
    let damaged = reader.entries_at(start as u64).unwrap_err().to_string();
    assert!(damaged.contains("checksum") || damaged.contains("undecompressable"), "{damaged}");
}
