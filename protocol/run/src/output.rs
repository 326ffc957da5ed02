//! What a process of a run has printed: the end of its file.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

/// The last lines of a file, `bytes` of them at most; whole ones where they do not begin the file.
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
