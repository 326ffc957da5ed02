//! The Python package `goalward` together with the programs: it reads a run's log, its demonstrations and its
//! exported policy, acts in our tasks, and writes demonstrations from which training gives the same bits.
//!
//! The test needs the packages of `tests/requirements.txt`; `GOALWARD_PYTHON=none` skips it.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::path::Path;
use std::process::Command;

use serde_json::Value;
use system_tests::{TestRun, programs, python};

/// The package's source in the repository.
const PACKAGE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../python/src");

fn with_package(mut command: Command) -> Vec<u8> {
    let output = command.env("PYTHONPATH", PACKAGE).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    output.stdout
}

#[test]
fn the_package_and_the_programs_understand_each_other() {
    let Some(python) = python() else { return };
    let run = TestRun::new(programs!());
    let summary = run.train_task("fetch-push", &[]).finish();
    let hashes = summary.hashes();
    let text = |path: &Path| path.to_str().unwrap().to_owned();
    let [folder, export, dataset, imported] =
        [run.folder().path(), &run.path("export"), &run.path("d.npz"), &run.path("d.mcap")]
            .map(text);
    let (well, said) = run.goalward(&["export", &folder, "--out", &export]);
    assert!(well, "{said}");

    let mut script = Command::new(&python);
    script.arg(concat!(env!("CARGO_MANIFEST_DIR"), "/python_package.py"));
    script
        .args([&folder, &export, &dataset])
        .env("GOALWARD_ACTOR", run.program("goalward-actor").get_program());
    let found: Value = serde_json::from_slice(&with_package(script)).unwrap();
    assert_eq!(found["episodes"].as_u64(), Some(summary.episodes), "{found}");
    assert_eq!(found["steps"].as_u64(), Some(summary.environment_steps), "{found}");
    assert_eq!(found["observed"], found["steps"], "{found}");
    assert_eq!(found["weights"].as_str(), Some(hashes.policy.as_str()), "{found}");
    assert_eq!(found["exported"], found["weights"], "{found}");
    assert!((1..=60).contains(&found["acted"].as_u64().unwrap()), "{found}");

    let mut import = run.program("goalward");
    import.args(["demonstrations", "import", &dataset, "--task", "fetch-push", "--out", &imported]);
    import.args(["--success", "all"]);
    with_package(import);
    let other = TestRun::new(programs!());
    let file = format!("demonstrations.file={imported}");
    let again = other.train_task("fetch-push", &[&file]).finish();
    assert_eq!(again.hashes(), hashes, "states alone, by way of a data set");
}
