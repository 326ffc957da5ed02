//! The tables of the results are those of the data beside them.
//!
//! Method: the script that writes them finds nothing to write in the repository, and complains of copies in
//! which a number of a table, or of a run, is another. It needs Python alone; `GOALWARD_PYTHON=none` leaves
//! this out.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

const REPOSITORY: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/..");

/// What of the repository the script reads.
const FILES: [&str; 5] = [
    "README.md",
    "docs/results/README.md",
    "docs/results/rebuild.py",
    "docs/results/runs.csv",
    "docs/results/curves.csv",
];

/// Whether the script is content with the pages of a repository, and what it says.
fn checked(root: &Path) -> Option<(bool, String)> {
    let python = std::env::var("GOALWARD_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let script = root.join("docs/results/rebuild.py");
    let output = || Command::new(&python).arg(script).arg("--check").output().unwrap();
    let Output { status, stderr, .. } = (python != "none").then(output)?;
    Some((status.success(), String::from_utf8(stderr).unwrap()))
}

/// The repository, with a change to one of its files.
fn check_changed(file: &str, change: impl Fn(&str) -> String) -> Option<(bool, String)> {
    let copy = tempfile::tempdir().unwrap();
    fs::create_dir_all(copy.path().join("docs/results")).unwrap();
    for name in FILES {
        let text = fs::read_to_string(Path::new(REPOSITORY).join(name)).unwrap();
        let text = if name == file { change(&text) } else { text };
        fs::write(copy.path().join(name), text).unwrap();
    }
    checked(copy.path())
}

#[test]
fn tables_and_data_do_not_differ() {
    let Some((well, said)) = checked(Path::new(REPOSITORY)) else { return };
    assert!(well && said.is_empty(), "{said}");
}

#[test]
fn a_number_that_is_another_is_found() {
    let in_a_table = |text: &str| {
        let (before, table) = text.split_once("<!-- table: ").unwrap();
        format!("{before}<!-- table: {}", table.replacen("| **", "| **1", 1))
    };
    let Some((well, said)) = check_changed("docs/results/README.md", in_a_table) else { return };
    assert!(!well && said.contains("docs/results/README.md"), "{said}");
    let of_a_run = |text: &str| text.replacen(",500,0.", ",500,0.1", 1);
    let (well, said) = check_changed("docs/results/runs.csv", of_a_run).unwrap();
    assert!(!well, "{said}");
}
