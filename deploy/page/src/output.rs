//! Output of a run's processes: the end of each one's file.

use std::fs;

use run::folder::RunFolder;
use run::output::end;
use serde::Serialize;

/// Maximum number of bytes of a file that are shown.
const SHOWN_BYTES: u64 = 16 << 10;

/// The end of a process's output.
#[derive(Debug, PartialEq, Eq, Serialize)]
pub(crate) struct Output {
    name: String,
    text: String,
}

impl Output {
    /// Returns the output of each process of a run that has printed anything, sorted by name.
    pub(crate) fn of(folder: &RunFolder) -> Vec<Output> {
        let files = fs::read_dir(folder.output()).into_iter().flatten().flatten();
        let mut found: Vec<Output> = files
            .filter_map(|file| {
                let name = file.file_name().into_string().ok()?;
                let name = name.strip_suffix(".log")?.to_owned();
                let text =
                    end(&file.path(), SHOWN_BYTES).ok().filter(|text| !text.trim().is_empty())?;
                Some(Output { name, text })
            })
            .collect();
        found.sort_by(|one, other| one.name.cmp(&other.name));
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_end_of_a_long_file_is_shown_in_whole_lines() {
        let directory = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(directory.path());
        assert_eq!(Output::of(&folder), []);
        fs::create_dir(folder.output()).unwrap();
        let lines: String = (0..10_000).map(|number| format!("line {number}\n")).collect();
        fs::write(folder.output().join("learner.log"), lines).unwrap();
        fs::write(folder.output().join("actor-0.log"), "joined\n").unwrap();
        fs::write(folder.output().join("actor-1.log"), "\n").unwrap();
        let found = Output::of(&folder);
        assert_eq!((found.len(), found[0].text.as_str()), (2, "joined\n"));
        assert!(found[1].text.starts_with("line ") && found[1].text.ends_with("line 9999\n"));
    }
}
