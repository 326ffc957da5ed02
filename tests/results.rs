//! The tables of the results are those of the data beside them.
//!
//! Method: the script that writes them finds nothing to write in the repository, and complains of copies in
//! which a number of a table, of a run, or of a plan is another. It needs the packages of
//! `tests/requirements.txt` for the interpreter in `GOALWARD_PYTHON` (default `python3`);
//! `GOALWARD_PYTHON=none` leaves this out.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use tempfile::TempDir;

const REPOSITORY: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/..");

/// What of the repository the script reads, and the plans.
const FILES: [&str; 5] = [
    "README.md",
    "docs/results/README.md",
    "docs/results/rebuild.py",
    "docs/results/runs.csv",
    "docs/results/points.csv",
];
const PLANS: &str = "deploy/experiments";

/// Whether the script is content with a repository, and what it says.
fn rebuilt(root: &Path, arguments: &[&str]) -> Option<(bool, String)> {
    let python = std::env::var("GOALWARD_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let script = root.join("docs/results/rebuild.py");
    let output = || Command::new(&python).arg(script).args(arguments).output().unwrap();
    let Output { status, stderr, .. } = (python != "none").then(output)?;
    Some((status.success(), String::from_utf8(stderr).unwrap()))
}

/// A copy of what the script reads.
fn copied() -> TempDir {
    let copy = tempfile::tempdir().unwrap();
    let plans = fs::read_dir(Path::new(REPOSITORY).join(PLANS)).unwrap();
    let plans = plans.map(|plan| Path::new(PLANS).join(plan.unwrap().file_name()));
    for name in FILES.iter().map(PathBuf::from).chain(plans) {
        let target = copy.path().join(&name);
        fs::create_dir_all(target.parent().unwrap()).unwrap();
        fs::copy(Path::new(REPOSITORY).join(name), target).unwrap();
    }
    copy
}

#[test]
fn tables_and_data_do_not_differ() {
    let Some((well, said)) = rebuilt(Path::new(REPOSITORY), &["--check"]) else { return };
    assert!(well && said.is_empty(), "{said}");
}

#[test]
fn a_number_that_is_another_is_found() {
    for (file, number, other) in [
        ("docs/results/README.md", "| **", "| **1"),
        ("docs/results/runs.csv", ",500,0.", ",500,0.1"),
        ("deploy/experiments/figure3.toml", "gaifo = 0.", "gaifo = 0.5"),
    ] {
        let copy = copied();
        let changed = copy.path().join(file);
        let text = fs::read_to_string(&changed).unwrap();
        let (before, behind) = text.split_once(number).unwrap();
        fs::write(&changed, format!("{before}{other}{behind}")).unwrap();
        let Some((well, said)) = rebuilt(copy.path(), &["--check"]) else { return };
        assert!(!well && said.contains("docs/results/README.md: expected"), "{file}: {said}");
    }
}

#[test]
fn a_report_takes_the_places_of_its_finished_runs_alone() {
    let copy = copied();
    let data = copy.path().join("docs/results");
    let [runs, points] =
        ["runs.csv", "points.csv"].map(|name| fs::read_to_string(data.join(name)).unwrap());
    let lines: Vec<&str> = runs.lines().collect();
    let finished = lines[1].replace(",500,0.", ",500,0.1");
    let unfinished = lines[2].replace(",goalward,1,", ",goalward,0,");
    assert!(finished != lines[1] && unfinished != lines[2], "{}", lines[1..3].join("\n"));
    let report = copy.path().join("report");
    fs::create_dir(&report).unwrap();
    let summary = [lines[0], unfinished.as_str(), finished.as_str()].join("\n");
    fs::write(report.join("summary.csv"), summary).unwrap();
    // Of twenty points the first run has the last one now.
    let (head, rows) = points.split_once('\n').unwrap();
    let kept = rows.splitn(20, '\n').last().unwrap();
    let point = kept.lines().next().unwrap();
    fs::write(report.join("results.csv"), format!("{head}\n{point}\n")).unwrap();
    let Some((well, said)) = rebuilt(copy.path(), &["--from", report.to_str().unwrap()]) else {
        return;
    };
    assert!(well && said.is_empty(), "{said}");
    let read = |name: &str| fs::read_to_string(data.join(name)).unwrap();
    assert_eq!(read("runs.csv"), runs.replacen(lines[1], &finished, 1));
    assert_eq!(read("points.csv"), format!("{head}\n{kept}"));
}
