//! The output of processes. Each process appends to a file of its own; those of a run are in its folder `output`.

use std::fs::{File, OpenOptions};
use std::path::PathBuf;

use anyhow::{Context, Result};
use run::folder::RunFolder;

use crate::headway;

/// Most lines quoted when a process has failed.
const QUOTED_LINES: usize = 8;

/// Bytes at the end of the file in which these lines are looked for.
const QUOTED_BYTES: u64 = 8 << 10;

/// The file that a process prints to.
#[derive(Clone, Debug)]
pub(crate) struct Output {
    path: PathBuf,
}

impl Output {
    /// Returns the output of the run's process called `name`.
    pub(crate) fn of(folder: &RunFolder, name: &str) -> Self {
        Output { path: folder.output().join(format!("{name}.log")) }
    }

    /// Returns the output that is kept in the file `path`.
    pub(crate) fn at(path: PathBuf) -> Self {
        Output { path }
    }

    /// Opens the file for appending.
    ///
    /// # Errors
    /// When it cannot be created.
    pub(crate) fn open(&self) -> Result<File> {
        let opened = OpenOptions::new().create(true).append(true).open(&self.path);
        opened.with_context(|| format!("opening {}", self.path.display()))
    }

    /// Returns the last lines for an error message: first the file's path, then each line on a line of its own.
    pub(crate) fn last_lines(&self) -> String {
        let shown = self.path.display();
        match self.end() {
            Ok(end) if end.trim().is_empty() => format!("it printed nothing to {shown}"),
            Ok(end) => {
                let lines: Vec<_> = end.lines().filter(|line| tells(line)).collect();
                let quoted = &lines[lines.len().saturating_sub(QUOTED_LINES)..];
                format!("the end of {shown}:\n    {}", quoted.join("\n    "))
            }
            Err(error) => format!("{shown} cannot be read: {error}"),
        }
    }

    /// Returns the last lines unchanged.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub(crate) fn end(&self) -> std::io::Result<String> {
        run::output::end(&self.path, QUOTED_BYTES)
    }
}

/// Returns whether a line may say something about a failure: progress and empty lines do not.
fn tells(line: &str) -> bool {
    !line.trim().is_empty() && headway::read(line).is_none()
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    #[test]
    fn the_last_lines_are_quoted() {
        let directory = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(directory.path());
        std::fs::create_dir(folder.output()).unwrap();
        let output = Output::of(&folder, "learner");
        assert!(output.last_lines().contains("cannot be read"));
        let mut file = output.open().unwrap();
        assert!(output.last_lines().contains("printed nothing"));
        for number in 0..2000 {
            writeln!(file, "line {number}").unwrap();
        }
        let quoted = output.last_lines();
        assert!(quoted.ends_with("    line 1998\n    line 1999"), "{quoted}");
        assert_eq!(quoted.lines().count(), 1 + QUOTED_LINES);
    }
}
