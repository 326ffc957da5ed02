//! Malicious files: they cost no more memory and time than an honest file may.
//!
//! Method: a file of ours gets chunks that its writer would not have made. Memory is the peak of what the reader
//! allocates.

use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use mcap_log::{Contents, Ending, FileWriter, info, repair};

use crate::{layout, metadata};

/// Maximum size of an unpacked chunk.
const LIMIT: usize = 64 << 20;

/// Memory that a reader may take: for a chunk packed, unpacked, and as messages.
const MEMORY: u64 = 4 * LIMIT as u64;

/// Nothing here takes this long even on the slowest machine. Without limits it takes minutes or hours.
const PATIENCE: Duration = Duration::from_secs(60);

/// Makes a file of ours up to its channels, followed by these chunks.
fn file_with(folder: &Path, chunks: &[Vec<u8>]) -> PathBuf {
    let path = folder.join("file.mcap");
    drop(FileWriter::create(&path, &metadata(), Contents::Trajectories.topics()).unwrap());
    let active = path.with_extension("mcap.active");
    let mut bytes = fs::read(&active).unwrap();
    assert_eq!(layout(&bytes).last().unwrap().0, 0x06, "the chunk of the channels");
    bytes.extend(chunks.concat());
    fs::write(&active, bytes).unwrap();
    active
}

/// Returns a chunk with these data and without a checksum.
fn chunk(compression: &str, uncompressed_bytes: u64, data: &[u8]) -> Vec<u8> {
    let mut content = Vec::new();
    for number in [0, 0, uncompressed_bytes] {
        content.extend(u64::to_le_bytes(number));
    }
    content.extend(0u32.to_le_bytes());
    content.extend((compression.len() as u32).to_le_bytes());
    content.extend(compression.as_bytes());
    content.extend((data.len() as u64).to_le_bytes());
    content.extend(data);
    record(0x06, &content)
}

fn record(kind: u8, content: &[u8]) -> Vec<u8> {
    [&[kind], (content.len() as u64).to_le_bytes().as_slice(), content].concat()
}

/// Returns a message of the first of our channels.
fn message(number: u32, data: &[u8]) -> Vec<u8> {
    let mut content = 1u16.to_le_bytes().to_vec();
    content.extend(number.to_le_bytes());
    content.extend([0; 16]);
    content.extend(data);
    record(0x05, &content)
}

fn zstd_of_zeros(bytes: usize) -> Vec<u8> {
    let mut encoder = zstd::Encoder::new(Vec::new(), 1).unwrap();
    let zeros = vec![0; 1 << 20];
    for _ in 0..bytes >> 20 {
        encoder.write_all(&zeros).unwrap();
    }
    encoder.finish().unwrap()
}

/// Returns the results of `info` and `repair`, and checks the memory and time they take.
fn within_limits(path: &Path) -> [Result<Ending, String>; 2] {
    let begun = Instant::now();
    let mut said = None;
    let used = allocation_counter::measure(|| {
        let found = info(path).map(|info| info.unwrap().ending).map_err(|error| error.to_string());
        let repaired = repair(path).map_err(|error| error.to_string());
        said = Some([found, repaired.map(|_| Ending::Complete)]);
    });
    assert!(used.bytes_max < MEMORY, "{} MiB for {said:?}", used.bytes_max >> 20);
    assert!(begun.elapsed() < PATIENCE, "{:?} for {said:?}", begun.elapsed());
    said.unwrap()
}

/// Expects the file to be read, with damage named by `words`.
fn damaged(chunks: &[Vec<u8>], words: &str) {
    let folder = tempfile::tempdir().unwrap();
    let path = file_with(folder.path(), chunks);
    let [found, repaired] = within_limits(&path);
    let ending = found.unwrap();
    assert!(ending.lost() && ending.to_string().contains(words), "{ending}");
    repaired.unwrap();
}

/// Expects the file to be refused with a message that contains `words`.
fn refused(chunks: &[Vec<u8>], words: &str) {
    let folder = tempfile::tempdir().unwrap();
    let path = file_with(folder.path(), chunks);
    for said in within_limits(&path) {
        let error = said.unwrap_err();
        assert!(error.contains(words) && error.contains("file.mcap.active: byte"), "{error}");
    }
    assert!(path.exists());
}

/// Expects the file to be read up to a chunk of too many records, and repair to refuse it because all of it is such
/// chunks.
fn damaged_and_refused(chunks: &[Vec<u8>], words: &str) {
    let folder = tempfile::tempdir().unwrap();
    let path = file_with(folder.path(), chunks);
    let [found, repaired] = within_limits(&path);
    let ending = found.unwrap();
    assert!(ending.to_string().contains("expected up to 1048576 records"), "{ending}");
    let error = repaired.unwrap_err();
    assert!(error.contains(words), "{error}");
}

#[test]
fn a_run_of_zeros_is_not_made_longer_than_it_says() {
    let zeros = zstd_of_zeros(4 << 30);
    assert!(zeros.len() < 1 << 20);
    damaged(&[chunk("zstd", 1000, &zeros)], "undecompressable to 1000 bytes");
    damaged(&[chunk("zstd", LIMIT as u64, &zeros)], "undecompressable to 67108864 bytes");
    damaged(&[chunk("zstd", 4 << 30, &zeros)], "expected a chunk of up to 67108864 bytes");
    damaged(&[chunk("zstd", u64::MAX, &zeros)], "expected a chunk of up to 67108864 bytes");
    damaged(&[chunk("zstd", 1 << 20, &zstd_of_zeros(0))], "found 0");
}

#[test]
fn chunks_of_zeros_are_taken_as_often_as_a_file_is_long() {
    let one = chunk("zstd", LIMIT as u64, &zstd_of_zeros(LIMIT));
    let chunks = vec![one; 450];
    let length: usize = chunks.iter().map(Vec::len).sum();
    assert!((500_000..4_000_000).contains(&length), "{length}");
    // Zeros are records of an unknown kind and of length 0.
    damaged_and_refused(&chunks, "grow to 10000 times");
}

#[test]
fn many_small_messages_do_not_exhaust_memory() {
    let small = message(0, &[]);
    let count = LIMIT / small.len();
    let packed = zstd::encode_all(small.repeat(count).as_slice(), 1).unwrap();
    let one = chunk("zstd", (count * small.len()) as u64, &packed);
    let chunks = vec![one; (900 << 10) / packed.len()];
    damaged(&chunks[..1], "expected up to 1048576 records");
    damaged_and_refused(&chunks, "one for every two bytes");
    let few = 1 << 20;
    let packed = zstd::encode_all(small.repeat(few).as_slice(), 1).unwrap();
    let one = chunk("zstd", (few * small.len()) as u64, &packed);
    refused(&vec![one; (900 << 10) / packed.len()], "one for every two bytes");
}

#[test]
fn one_message_as_long_as_a_chunk_is_read() {
    let long = message(0, &vec![7; LIMIT - 31]);
    assert_eq!(long.len(), LIMIT);
    let folder = tempfile::tempdir().unwrap();
    let packed = zstd::encode_all(long.as_slice(), 1).unwrap();
    let path = file_with(folder.path(), &[chunk("zstd", LIMIT as u64, &packed)]);
    let used = allocation_counter::measure(|| {
        assert_eq!(info(&path).unwrap().unwrap().raw_bytes, LIMIT as u64 - 31);
    });
    assert!(used.bytes_max < MEMORY, "{} MiB", used.bytes_max >> 20);
}

#[test]
fn a_compression_that_is_not_supported_is_no_damage() {
    refused(&[chunk("lz4", 31, b"whatever")], "found lz4, which is not supported");
    damaged(&[chunk("zstb", 31, b"whatever")], "found \"zstb\"");
}

#[test]
fn declarations_are_short() {
    let long = record(0x03, &vec![0; 2 << 20]);
    damaged(&[chunk("", long.len() as u64, &long)], "expected up to 1048576 bytes");
    let folder = tempfile::tempdir().unwrap();
    let path = file_with(folder.path(), &[]);
    let bytes = fs::read(&path).unwrap();
    let header = layout(&bytes)[0];
    let metadata = record(0x0c, &vec![0; 2 << 20]);
    fs::write(&path, [&bytes[..header.1 + header.2], &metadata].concat()).unwrap();
    let error = info(&path).unwrap_err().to_string();
    assert!(error.contains("one of 2097152 bytes"), "{error}");
}
