//! MCAP files: read, summarized, repaired, used as demonstrations.

use std::fs;
use std::path::{Path, PathBuf};

use mcap_log::{Contents, FileReader, FileWriter, Kind, Metadata, info, repair};
use protocol::trajectory::{Encoded, Source};
use run::demonstrations;
use tempfile::TempDir;

use crate::{Memory, Reader, fuzz, whole};

/// The memory that a chunk and its decoded messages may take.
const OF_CHUNKS: Memory = Memory { bytes: 256 << 20, per_byte: 1_000 };

/// Creates a folder in memory, so that thousands of files are cheap.
fn scratch() -> TempDir {
    tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).unwrap()
}

/// Makes a sealed file of demonstrations, and one that its writer never sealed.
fn files() -> Vec<Vec<u8>> {
    let folder = scratch();
    let metadata = Metadata::new(Kind::Demonstrations, "fetch-push", 1).with("setting", "{}");
    let write = |name: &str, is_sealed: bool| {
        let path = folder.path().join(name);
        let topics = Contents::Trajectories.topics();
        let mut writer = FileWriter::create(&path, &metadata, topics).unwrap();
        for time_ns in 0..3 {
            let trajectory = whole::trajectory("fetch-push", Source::Demonstration);
            writer.trajectory(&Encoded::encode(trajectory), time_ns).unwrap();
        }
        if is_sealed {
            writer.seal().unwrap();
            return fs::read(path).unwrap();
        }
        drop(writer);
        fs::read(folder.path().join(format!("{name}.active"))).unwrap()
    };
    vec![write("sealed.mcap", true), write("left.mcap", false)]
}

/// Writes bytes to a file for a reader.
fn put(folder: &Path, name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder.join(name);
    fs::write(&path, bytes).unwrap();
    path
}

#[test]
fn files_are_read() {
    let folder = scratch();
    let read = |bytes: &[u8]| {
        let path = put(folder.path(), "some.mcap", bytes);
        let mut reader = FileReader::open(&path).map_err(|error| error.to_string())?;
        for entry in &mut reader {
            entry.map_err(|error| error.to_string())?;
        }
        assert!(reader.ending().is_some(), "a file that was read has an end");
        let said = info(&path).map_err(|error| error.to_string())?;
        assert!(said.is_none_or(|said| !said.to_string().is_empty()));
        Ok(())
    };
    fuzz(files(), &Reader { memory: OF_CHUNKS, read: &read });
}

#[test]
fn files_are_demonstrations() {
    let folder = scratch();
    let task = whole::config("fetch-push").task;
    let read = |bytes: &[u8]| {
        let path = put(folder.path(), "some.mcap", bytes);
        let read = demonstrations::read(&path, &task, true).map_err(|error| error.to_string())?;
        for trajectory in read {
            assert!(!trajectory.observations_to_goal().is_empty());
        }
        Ok(())
    };
    // An unsealed file is not accepted as demonstrations.
    fuzz(files().drain(..1).collect(), &Reader { memory: OF_CHUNKS, read: &read });
}

#[test]
fn files_are_repaired() {
    let read = |bytes: &[u8]| {
        let folder = scratch();
        let path = put(folder.path(), "some.mcap.active", bytes);
        let repair = repair(&path).map_err(|error| error.to_string())?;
        let Some(sealed) = repair.sealed else {
            return Err("nothing to seal".to_owned());
        };
        // A chunk without a checksum may hold invalid messages; they are kept as they are.
        let info = info(&sealed).map_err(|error| error.to_string())?;
        assert!(info.is_some_and(|info| !info.ending.lost()), "what is sealed again is whole");
        Ok(())
    };
    fuzz(files(), &Reader { memory: OF_CHUNKS, read: &read });
}
