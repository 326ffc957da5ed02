//! Reads the end of the file that a process of a run prints to.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

/// Returns the last lines of a file, at most `bytes` bytes. A line that may have lost its beginning is left out.
///
/// # Errors
/// When the file cannot be read.
pub fn end(path: &Path, bytes: u64) -> io::Result<String> {
    let mut file = File::open(path)?;
    let begin = file.metadata()?.len().saturating_sub(bytes);
    file.seek(SeekFrom::Start(begin))?;
    let mut found = Vec::new();
    file.take(bytes).read_to_end(&mut found)?;
    let text = String::from_utf8_lossy(&found).into_owned();
    Ok(match text.split_once('\n') {
        Some((_, whole)) if begin > 0 => whole.to_owned(),
        _ => text,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_end_of_a_long_file_begins_with_a_whole_line() {
        let directory = tempfile::tempdir().unwrap();
        let file = directory.path().join("learner.log");
        assert!(end(&file, 100).is_err());
        let lines: String = (0..1000).map(|number| format!("line {number}\n")).collect();
        std::fs::write(&file, &lines).unwrap();
        assert_eq!(end(&file, 20).unwrap(), "line 998\nline 999\n");
        assert_eq!(end(&file, 1 << 20).unwrap(), lines);
    }
}
