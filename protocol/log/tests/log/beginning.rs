//! Damage before the first chunk, where magic, header and metadata are: the records are read all the same, repair
//! takes the metadata from the run's other files, and files of others are still refused.
//!
//! Method: bits of one file of a small run are flipped. Its other files are whole.

use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};

use mcap_log::{
    Contents, Ending, Entry, FileReader, FileWriter, LogOptions, LogWriter, Metadata, Topic, info,
    read_contents, read_run, recorded_metadata, repair,
};
use prost::Message;
use protocol::messages::{Checkpoint, PolicyUpdate};

use crate::{layout, metadata, names, trajectory};

const FILES: [&str; 2] = ["trajectories-00000.mcap", "updates-00000.mcap"];

/// Records some iterations, and seals the files or leaves them as a crash does.
fn sit(folder: &Path, metadata: &Metadata, iterations: Range<u64>, is_sealed: bool) {
    let mut log = LogWriter::create(folder, metadata, LogOptions::default()).unwrap();
    for iteration in iterations {
        log.trajectory(&trajectory(iteration, iteration, 100)).unwrap();
        log.policy_update(&PolicyUpdate { iteration, ..PolicyUpdate::default() }).unwrap();
        log.checkpoint(&Checkpoint { iteration, ..Checkpoint::default() }).unwrap();
    }
    if is_sealed {
        log.finish().unwrap();
    }
}

fn entries(folder: &Path) -> Vec<Entry> {
    read_run(folder).unwrap().map(Result::unwrap).collect()
}

/// Returns where the first chunk begins.
fn first_chunk(file: &[u8]) -> usize {
    layout(file).into_iter().find(|&(kind, ..)| kind == 0x06).unwrap().1
}

/// Returns where some text begins that is before the first chunk.
fn place(file: &[u8], text: &str) -> usize {
    let beginning = &file[..first_chunk(file)];
    let mut places = beginning.windows(text.len()).enumerate();
    places.find(|(_, found)| *found == text.as_bytes()).unwrap().0
}

fn flip(path: &Path, at: usize) {
    let mut bytes = fs::read(path).unwrap();
    bytes[at] ^= 4;
    fs::write(path, bytes).unwrap();
}

/// Returns what is lost of a run, and which files.
fn lost(folder: &Path) -> Vec<(PathBuf, Ending)> {
    let run = read_run(folder).unwrap();
    run.endings().iter().filter(|(_, ending)| ending.lost()).cloned().collect()
}

#[test]
fn a_file_that_is_cut_off_before_its_metadata_is_named_if_it_is_all_there_is() {
    let folder = tempfile::tempdir().unwrap();
    sit(folder.path(), &metadata(), 0..1, true);
    let path = folder.path().join(FILES[0]);
    let file = fs::read(&path).unwrap();
    let cut = layout(&file)[1].1 + 10;
    fs::write(&path, &file[..cut]).unwrap();
    let refused = read_contents(folder.path(), Contents::Trajectories).err().unwrap().to_string();
    let expected = format!("cut off: the last {cut} bytes, from byte 0");
    assert!(refused.contains(FILES[0]) && refused.contains(&expected), "{refused}");
}

#[test]
fn a_run_is_read_whatever_bit_of_a_beginning_is_flipped() {
    let folder = tempfile::tempdir().unwrap();
    sit(folder.path(), &metadata(), 0..3, true);
    let whole = entries(folder.path());
    assert_eq!(whole.len(), 9);
    for name in FILES {
        let path = folder.path().join(name);
        let file = fs::read(&path).unwrap();
        let mut refused = Vec::new();
        // Three is prime to eight, so each place in a byte has its turn.
        for bit in (0..8 * first_chunk(&file)).step_by(3) {
            let mut damaged = file.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            fs::write(&path, damaged).unwrap();
            match read_run(folder.path()) {
                Ok(mut run) => {
                    let found: Vec<Entry> = run.by_ref().map(Result::unwrap).collect();
                    assert!(found == whole, "{name} bit {bit}");
                    assert_eq!(run.metadata(), &metadata(), "{name} bit {bit}");
                    let lost = run.endings().iter().filter(|(_, ending)| ending.lost());
                    let lost: Vec<&PathBuf> = lost.map(|(path, _)| path).collect();
                    assert_eq!(lost, [&path], "{name} bit {bit}");
                }
                Err(error) => refused.push(error.to_string()),
            }
        }
        fs::write(&path, file).unwrap();
        // In the number of the format: a newer one may mean anything.
        assert!(refused.len() <= 3, "{refused:?}");
        assert!(refused.iter().all(|error| error.contains("format version 1 or older, found")));
    }
}

#[test]
fn the_damage_is_named_with_its_file() {
    let folder = tempfile::tempdir().unwrap();
    sit(folder.path(), &metadata(), 0..3, true);
    let path = folder.path().join("updates-00000.mcap");
    let file = fs::read(&path).unwrap();
    flip(&path, place(&file, "goalward.run"));
    let [(lost, ending)] = &lost(folder.path())[..] else { panic!("one file") };
    assert_eq!(lost, &path);
    let Ending::Corrupt { offset: 0, lost_bytes, lost_records: Some(0), .. } = ending else {
        panic!("{ending}");
    };
    assert_eq!(*lost_bytes as usize, first_chunk(&file));
    let said = ending.to_string();
    assert!(said.contains("its beginning cannot be read (not recorded by goalward"), "{said}");
    let report = info(&path).unwrap().unwrap();
    assert_eq!((report.state(), report.messages[&Topic::Checkpoint]), ("damaged", 3));
    let updates = read_contents(folder.path(), Contents::Updates).unwrap();
    assert_eq!(updates.count(), 6, "the other contents tell the metadata");
}

#[test]
fn repair_takes_the_metadata_from_the_other_files() {
    // The magic, the length of the header, the kind of the metadata, its name, an entry's name.
    let places: [fn(&[u8]) -> usize; 5] = [
        |_| 1,
        |_| 10,
        |file| layout(file)[1].1,
        |file| place(file, "goalward.run"),
        |file| place(file, "format_version"),
    ];
    for ending in ["mcap", "mcap.active"] {
        for at in places {
            let folder = tempfile::tempdir().unwrap();
            sit(folder.path(), &metadata(), 0..3, ending == "mcap");
            let whole = entries(folder.path());
            for name in FILES {
                let sealed = folder.path().join(name);
                let path = sealed.with_extension(ending);
                flip(&path, at(&fs::read(&path).unwrap()));
                let damaged = fs::read(&path).unwrap();
                let repaired = repair(&path).unwrap();
                assert_eq!(repaired.sealed.as_ref(), Some(&sealed));
                assert_eq!(repaired.lost, 0, "{repaired}");
                assert!(repaired.damage[0].contains("its beginning cannot be read"), "{repaired}");
                assert_eq!(fs::read(repaired.damaged.unwrap()).unwrap(), damaged);
                assert_eq!(FileReader::open(&sealed).unwrap().metadata(), &metadata());
            }
            assert_eq!((entries(folder.path()), lost(folder.path())), (whole, Vec::new()));
        }
    }
}

#[test]
fn damaged_values_are_not_sealed_as_if_they_were_whole() {
    let folder = tempfile::tempdir().unwrap();
    let metadata = metadata().with("config", "ppo.clip = 0.2\n");
    sit(folder.path(), &metadata, 0..3, true);
    let whole = entries(folder.path());
    let path = folder.path().join("trajectories-00000.mcap");
    let file = fs::read(&path).unwrap();
    flip(&path, place(&file, "ppo.clip"));
    assert_eq!(recorded_metadata(folder.path()).unwrap(), std::slice::from_ref(&metadata));
    assert_eq!(entries(folder.path()), whole);
    let repaired = repair(&path).unwrap();
    assert!(repaired.damage[0].contains("what they agree on"), "{repaired}");
    assert_eq!(FileReader::open(&path).unwrap().metadata(), &metadata);
    assert_eq!((entries(folder.path()), lost(folder.path())), (whole, Vec::new()));

    // What the damaged file and another have in common is not doubted: the index of a chunk is damaged.
    let &(_, index, length) = layout(&file).iter().find(|&&(kind, ..)| kind == 0x07).unwrap();
    fs::write(&path, &file).unwrap();
    flip(&path, index + length - 1);
    let repaired = repair(&path).unwrap();
    assert_eq!(repaired.damage.len(), 1, "{repaired}");
    assert_eq!(FileReader::open(&path).unwrap().metadata(), &metadata);
}

#[test]
fn nothing_is_made_up_where_the_other_files_differ() {
    let folder = tempfile::tempdir().unwrap();
    let settings = [2, 3].map(|actors| {
        metadata().with("config", format!("ppo.clip = 0.2\nresources.actors = {actors}"))
    });
    sit(folder.path(), &settings[0], 0..3, true);
    sit(folder.path(), &settings[1], 3..6, true);
    let whole = entries(folder.path());
    let path = folder.path().join("updates-00000.mcap");
    flip(&path, 0);
    assert_eq!(entries(folder.path()), whole);
    repair(&path).unwrap();
    let mut expected = metadata();
    expected.entries.remove("config");
    assert_eq!(FileReader::open(&path).unwrap().metadata(), &expected);
    assert_eq!((entries(folder.path()), lost(folder.path())), (whole, Vec::new()));
}

#[test]
fn records_behind_a_damaged_first_chunk_are_repaired_but_not_read() {
    let folder = tempfile::tempdir().unwrap();
    sit(folder.path(), &metadata(), 0..3, true);
    let path = folder.path().join("trajectories-00000.mcap");
    let mut file = fs::read(&path).unwrap();
    let (_, start, length) = layout(&file).into_iter().find(|&(kind, ..)| kind == 0x06).unwrap();
    file[..start + length].fill(0);
    fs::write(&path, file).unwrap();
    // The first trajectory is lost, so the next ones would come with a gap before them.
    assert_eq!(entries(folder.path()).len(), 6);
    let repaired = repair(&path).unwrap();
    assert_eq!((repaired.kept[&Topic::Trajectory], repaired.lost), (2, 1), "{repaired}");
    assert_eq!(entries(folder.path()).len(), 8);
}

#[test]
fn what_cannot_be_told_to_be_of_the_run_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    sit(folder.path(), &metadata(), 0..3, true);
    let path = folder.path().join("updates-00000.mcap");
    let file = fs::read(&path).unwrap();
    let refusal = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        fs::write(&path, bytes).unwrap();
        let refused = [FileReader::open(&path).err().unwrap(), repair(&path).unwrap_err()];
        let run = read_run(folder.path()).err();
        assert_eq!(fs::read(&path).unwrap(), bytes);
        fs::remove_file(&path).unwrap();
        let [refused, again] = refused.map(|error| error.to_string());
        assert_eq!(refused, again);
        (refused, run.map(|error| error.to_string()))
    };
    let another = "trajectories-00001.mcap";
    let (refused, run) = refusal(another, b"not at all");
    assert!(refused.contains("expected an MCAP file, found one that begins with"), "{refused}");
    assert_eq!(run, Some(refused));
    // Another program wrote it, and its topics are not ours.
    let mut foreign = mcap::Writer::new(std::io::Cursor::new(Vec::new())).unwrap();
    let channel = foreign.add_channel(0, "/camera", "raw", &Default::default()).unwrap();
    let header = mcap::records::MessageHeader {
        channel_id: channel,
        sequence: 0,
        log_time: 0,
        publish_time: 0,
    };
    foreign.write_to_known_channel(&header, b"picture").unwrap();
    foreign.finish().unwrap();
    let (refused, run) = refusal(another, foreign.into_inner().get_ref());
    assert!(refused.contains("not recorded by goalward"), "{refused}");
    assert_eq!(run, Some(refused));

    // A file by itself, and one with a name that no file of a run has.
    let mut damaged = file.clone();
    damaged[place(&file, "goalward.run")] ^= 4;
    let (refused, run) = refusal("other.mcap", &damaged);
    assert!(refused.contains("not recorded by goalward") && run.is_none(), "{refused}");
    for name in names(folder.path()) {
        fs::remove_file(folder.path().join(name)).unwrap();
    }
    let (refused, run) = refusal("updates-00000.mcap", &damaged);
    assert!(refused.contains("not recorded by goalward"), "{refused}");
    assert_eq!(run, Some(refused));
}

#[test]
fn a_newer_format_is_no_damage() {
    let folder = tempfile::tempdir().unwrap();
    sit(folder.path(), &metadata(), 0..3, true);
    let path = folder.path().join("updates-00001.mcap");
    let newer = metadata().with("format_version", 2);
    let mut writer = FileWriter::create(&path, &newer, Contents::Updates.topics()).unwrap();
    writer.message(Topic::Checkpoint, 9, &Checkpoint::default().encode_to_vec()).unwrap();
    writer.seal().unwrap();
    let error = read_run(folder.path()).err().unwrap().to_string();
    assert!(error.contains("format version 1 or older, found 2"), "{error}");
    assert!(repair(&path).is_err());
}
