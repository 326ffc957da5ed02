//! TensorBoard event files: records of protobuf messages, each with its length and checksums.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use prost::Message;

/// File name; TensorBoard recognizes event files by `tfevents` in the name.
const NAME: &str = "events.out.tfevents.goalward";

/// The file version, in the first record.
const VERSION: &str = "brain.Event:2";

/// A record, `tensorboard.Event`.
#[derive(Clone, PartialEq, Message)]
struct Event {
    /// Seconds since 1970.
    #[prost(double, tag = "1")]
    wall_time: f64,
    #[prost(int64, tag = "2")]
    step: i64,
    #[prost(oneof = "What", tags = "3, 5")]
    what: Option<What>,
}

#[derive(Clone, PartialEq, prost::Oneof)]
enum What {
    #[prost(string, tag = "3")]
    FileVersion(String),
    #[prost(message, tag = "5")]
    Summary(Values),
}

/// `tensorboard.Summary`.
#[derive(Clone, PartialEq, Message)]
struct Values {
    #[prost(message, repeated, tag = "1")]
    value: Vec<Value>,
}

/// `tensorboard.Summary.Value`.
#[derive(Clone, PartialEq, Message)]
struct Value {
    #[prost(string, tag = "1")]
    tag: String,
    #[prost(float, optional, tag = "2")]
    simple_value: Option<f32>,
}

/// An event file that is being written.
pub(crate) struct EventFile<W: Write = File> {
    file: BufWriter<W>,
}

impl EventFile {
    /// Creates the event file in a folder; an existing file is overwritten.
    pub(crate) fn create(folder: &Path, wall_time: f64) -> io::Result<EventFile> {
        let mut file = EventFile { file: BufWriter::new(File::create(folder.join(NAME))?) };
        file.record(&Event {
            wall_time,
            step: 0,
            what: Some(What::FileVersion(VERSION.to_owned())),
        })?;
        Ok(file)
    }
}

impl<W: Write> EventFile<W> {
    /// Writes numbers under their tags. NaN and infinite numbers are left out.
    pub(crate) fn scalars(
        &mut self,
        wall_time: f64,
        step: u64,
        scalars: &[(&str, f64)],
    ) -> io::Result<()> {
        let known = scalars.iter().filter(|(_, number)| number.is_finite());
        let value = |&(tag, number): &(&str, f64)| Value {
            tag: tag.to_owned(),
            simple_value: Some(number as f32),
        };
        let summary = Values { value: known.map(value).collect() };
        let what = Some(What::Summary(summary));
        self.record(&Event { wall_time, step: step as i64, what })
    }

    /// Passes everything written to the operating system.
    pub(crate) fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }

    /// Writes a complete record or, on failure, nothing of it, since readers cannot find a record after a partial one.
    /// The buffer is larger than a record. When a record does not fit, the buffer accepts it only after the system has
    /// taken the earlier content, and it keeps what the system has not taken.
    fn record(&mut self, event: &Event) -> io::Result<()> {
        let content = event.encode_to_vec();
        let length = (content.len() as u64).to_le_bytes();
        let parts: [&[u8]; 4] = [&length, &masked_crc(&length), &content, &masked_crc(&content)];
        self.file.write_all(&parts.concat())
    }
}

/// Returns the checksum of TensorFlow's records.
fn masked_crc(bytes: &[u8]) -> [u8; 4] {
    let crc = crc32c::crc32c(bytes);
    crc.rotate_right(15).wrapping_add(0xa282_ead8).to_le_bytes()
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    /// The bytes that TensorBoard 2.21 writes for the same two events with its own `RecordWriter`.
    const THEIRS: &str = "1800000000000000a37f4b220900001040fc54d9411a0d627261696e2e4576656e743a32338d2fe9\
        2b00000000000000861bc34b0900006040fc54d9411080202a1d0a1b0a14726f6c6c6f75742f73756363657373\
        5f72617465150000003f2d3f7dc7";

    #[test]
    fn the_bytes_are_those_of_tensorboard() {
        let directory = tempfile::tempdir().unwrap();
        let folder = directory.path();
        let mut file = EventFile::create(folder, 1_700_000_000.25).unwrap();
        let scalars = [("rollout/success_rate", 0.5), ("policy/entropy", f64::NAN)];
        file.scalars(1_700_000_001.5, 4096, &scalars).unwrap();
        file.flush().unwrap();
        let written = fs::read(folder.join(NAME)).unwrap();
        let written: String = written.iter().map(|byte| format!("{byte:02x}")).collect();
        assert_eq!(written, THEIRS);
    }

    /// A disk that takes `room` bytes, is full once, and then takes everything.
    struct Disk {
        taken: Vec<u8>,
        room: Option<usize>,
    }

    impl Write for Disk {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            let taken = self.room.unwrap_or(bytes.len()).min(bytes.len());
            if self.room == Some(0) {
                self.room = None;
                return Err(io::ErrorKind::StorageFull.into());
            }
            self.room = self.room.map(|room| room - taken);
            self.taken.extend(&bytes[..taken]);
            Ok(taken)
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    /// Writes records to a disk, each again until it succeeds; returns the disk's content and the number of failures.
    fn written(room: Option<usize>) -> (Vec<u8>, usize) {
        let mut file = EventFile { file: BufWriter::new(Disk { taken: Vec::new(), room }) };
        let mut failures = 0;
        for step in 0..1_000 {
            while file.scalars(0.0, step, &[("rollout/success_rate", 0.5)]).is_err() {
                failures += 1;
            }
        }
        while file.flush().is_err() {
            failures += 1;
        }
        (file.file.get_ref().taken.clone(), failures)
    }

    #[test]
    fn a_disk_that_was_full_has_no_half_of_a_record() {
        let (undisturbed, failures) = written(None);
        assert_eq!(failures, 0);
        for room in [0, 5_000, 20_000, undisturbed.len() - 1] {
            assert!(written(Some(room)) == (undisturbed.clone(), 1), "full after {room} bytes");
        }
    }
}
