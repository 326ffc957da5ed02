//! Provenance: logs, demonstrations, summaries and programs name their build, and neither a run nor a curve silently
//! mixes two builds.
//!
//! Method: small runs of the real programs. Another build is simulated by what it would have left: a log file with
//! its metadata, a summary with its commit.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::fs;
use std::path::Path;
use std::process::Output;

use mcap_log::{FileReader, LogOptions, LogWriter, recorded_builds};
use protocol::build::Build;
use run::folder::RunFolder;
use run::summary::Summary;
use system_tests::{SMALL, Signal, TestRun, programs};

/// Returns a build that is not the one under test.
fn other_build() -> Build {
    Build {
        version: "0.1.0".to_owned(),
        commit: "feedc0de00000000000000000000000000000000".to_owned(),
        rustc: "rustc 1.95.0".to_owned(),
        ..Build::default()
    }
}

fn builds_of(file: &Path) -> Build {
    FileReader::open(file).unwrap().metadata().build()
}

/// Adds to the run's log the file that another build would have left after continuing the run.
fn sit_for_other_build(folder: &RunFolder) {
    let first = FileReader::open(&folder.log().join("updates-00000.mcap")).unwrap();
    let build = serde_json::to_string(&other_build()).unwrap();
    let metadata = first.metadata().clone().with("build", build);
    LogWriter::create(&folder.log(), &metadata, LogOptions::default()).unwrap().finish().unwrap();
}

fn goalward(run: &TestRun, arguments: &[&str]) -> (Option<i32>, String) {
    let Output { status, stdout, stderr } =
        run.program("goalward").args(arguments).output().unwrap();
    (status.code(), String::from_utf8([stdout, stderr].concat()).unwrap())
}

#[test]
fn every_program_says_its_build() {
    let run = TestRun::new(programs!());
    for name in ["goalward", "goalward-actor", "goalward-learner", "goalward-proximity-service"] {
        let output = run.program(name).arg("--version").output().unwrap();
        let said = String::from_utf8(output.stdout).unwrap();
        let parts = [name, "0.1.0, commit ", "rustc 1.", "processor features "];
        assert!(parts.iter().all(|part| said.contains(part)), "{said}");
        assert_eq!(said.lines().count(), 1, "{said}");
    }
}

#[test]
fn a_run_is_continued_by_another_build_only_when_asked_to() {
    let run = TestRun::new(programs!());
    let mut training = run.train(&[]);
    training.await_checkpoint(4);
    training.signal(Signal::Interrupt);
    training.end();
    let folder = run.folder();
    let [own] = &recorded_builds(&folder.log()).unwrap()[..] else { panic!("one build") };
    assert!(!own.is_unknown() && own.programs_sha256.is_some(), "{own:?}");
    assert_eq!(&builds_of(&folder.demonstrations_file()), own);
    assert_eq!(&builds_of(&folder.log().join("trajectories-00000.mcap")), own);

    sit_for_other_build(&folder);
    let before = run.contents();
    let resume = ["train", "--resume", "--run", "run"];
    let (code, said) = goalward(&run, &resume);
    assert_eq!((code, said.lines().count()), (Some(2), 1), "{said}");
    for part in ["commit feedc0de0000", &own.to_string(), "--other-build"] {
        assert!(said.contains(part), "expected {part} in {said}");
    }
    assert_eq!(run.contents(), before, "a refusal leaves no trace");

    let (code, said) = goalward(&run, &[&resume[..], &["--other-build"]].concat());
    assert_eq!(code, Some(0), "{said}");
    let all = [own.clone(), other_build(), own.clone()];
    assert_eq!(recorded_builds(&folder.log()).unwrap(), all);
    assert_eq!(Summary::of_run(&folder).unwrap().unwrap().builds, all);
    assert!(said.contains("commit feedc0de0000"), "the table names it: {said}");
}

/// Writes a report on two runs and returns the names of its curves.
fn curves(run: &TestRun, report: &str) -> Vec<String> {
    let (code, said) = goalward(run, &["report", "one", "two", "--out", report]);
    assert_eq!(code, Some(0), "{said}");
    let table = fs::read_to_string(run.path(report).join("summary.csv")).unwrap();
    let name = |line: &str| {
        let rest = line.strip_prefix("runs,navigation,navigation,").unwrap();
        let quoted = rest.strip_prefix('"').and_then(|rest| rest.split_once('"'));
        quoted.or(rest.split_once(',')).unwrap().0.to_owned()
    };
    let mut names: Vec<_> = table.lines().skip(1).map(name).collect();
    names.dedup();
    names
}

#[test]
fn runs_of_two_builds_or_on_two_files_are_no_seeds_of_one_curve() {
    let run = TestRun::new(programs!());
    let recorded = ["demonstrate", "navigation", "--episodes", "40", "--coverage", "0.5", "--out"];
    for name in ["a.mcap", "b.mcap"] {
        let seed = if name == "a.mcap" { "11" } else { "12" };
        let (code, said) = goalward(&run, &[&recorded[..], &[name, "--seed", seed]].concat());
        assert_eq!(code, Some(0), "{said}");
    }
    let train = |folder: &str, settings: &[&str]| {
        let mut command = run.program("goalward");
        command.args(["train", "navigation", "--run", folder]);
        for setting in SMALL.iter().chain(&["steps=800", "evaluation.episodes=2"]).chain(settings) {
            command.args(["--set", setting]);
        }
        let output = command.output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    };
    train("one", &["seed=1"]);
    train("two", &["seed=2"]);
    assert_eq!(curves(&run, "own").len(), 1, "two seeds, each with its own demonstrations");

    let folder = RunFolder::new(run.path("two"));
    let summary = Summary::of_run(&folder).unwrap().unwrap();
    Summary { builds: vec![other_build()], ..summary.clone() }.save(&folder).unwrap();
    let apart = curves(&run, "builds");
    assert_eq!(apart.len(), 2, "{apart:?}");
    let named = apart.iter().filter(|curve| curve.contains("commit feedc0de0000"));
    assert_eq!(named.count(), 1, "{apart:?}");
    Summary { builds: Vec::new(), ..summary }.save(&folder).unwrap();
    let apart = curves(&run, "unknown");
    assert!(apart.iter().any(|curve| curve.contains("unknown build")), "{apart:?}");

    fs::remove_dir_all(run.path("one")).unwrap();
    fs::remove_dir_all(run.path("two")).unwrap();
    train("one", &["seed=1", "demonstrations.file=a.mcap"]);
    train("two", &["seed=2", "demonstrations.file=a.mcap"]);
    assert_eq!(curves(&run, "same").len(), 1, "two seeds on one file");
    fs::remove_dir_all(run.path("two")).unwrap();
    train("two", &["seed=2", "demonstrations.file=b.mcap"]);
    let apart = curves(&run, "files");
    assert_eq!(apart.len(), 2, "{apart:?}");
    assert!(apart.iter().all(|curve| curve.contains("demonstrations ")), "{apart:?}");
}
