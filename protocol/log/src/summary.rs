//! The summary at the end of a sealed file, which can be read without the rest.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

use mcap::records::{Record, Statistics, op};

use super::chunk::{RECORD_HEADER, each};
use super::record::{self, LONGEST_RECORD};

/// Bytes of the last record, the footer. It says where the summary begins, and ends with the summary's checksum.
const FOOTER: usize = RECORD_HEADER + 20;

/// Bytes of that checksum.
const CHECKSUM: usize = 4;

/// The records between data and footer.
pub(super) struct Summary {
    pub(super) records: Vec<u8>,
    has_right_checksum: bool,
}

impl Summary {
    /// Reads the summary of a file; `None` if it is missing or not readable.
    pub(super) fn read(path: &Path) -> Option<Summary> {
        let mut file = File::open(path).ok()?;
        let behind = (FOOTER + mcap::MAGIC.len()) as u64;
        let end = file.metadata().ok()?.len().checked_sub(behind)?;
        file.seek(SeekFrom::Start(end)).ok()?;
        let mut last = [0; FOOTER];
        file.read_exact(&mut last).ok()?;
        let (header, content) = last.split_first_chunk::<RECORD_HEADER>()?;
        let Ok(Record::Footer(footer)) = record::parse(header[0], content) else { return None };
        let length = end.checked_sub(footer.summary_start)?;
        if footer.summary_start == 0 || length > LONGEST_RECORD as u64 {
            return None;
        }
        file.seek(SeekFrom::Start(footer.summary_start)).ok()?;
        let mut records = Vec::new();
        file.take(length).read_to_end(&mut records).ok()?;
        let mut checksum = crc32fast::Hasher::new();
        checksum.update(&records);
        checksum.update(&last[..FOOTER - CHECKSUM]);
        let has_right_checksum = checksum.finalize() == footer.summary_crc;
        Some(Summary { records, has_right_checksum })
    }
}

/// Returns the statistics of a sealed file; `None` if they are missing or damaged.
pub(super) fn statistics(path: &Path) -> Option<Statistics> {
    let summary = Summary::read(path).filter(|summary| summary.has_right_checksum)?;
    let mut statistics = None;
    let take = |kind: u8, content: &[u8]| {
        if kind == op::STATISTICS
            && let Ok(Record::Statistics(found)) = record::parse(kind, content)
        {
            statistics = Some(found);
        }
        Ok(())
    };
    each(&summary.records, take).ok()?;
    statistics
}
