//! An experiment trains what is missing and nothing else, and its runs are those that
//! `goalward train` makes.
//!
//! Method: a plan of two methods and two seeds, two runs at a time. It is stopped as soon as one
//! run has a checkpoint, continued, and called once more when all is done. A run of it must then have
//! the hashes of the same run trained alone, with other numbers of actors and threads and with
//! demonstrations of its own. At last a run is spoilt: it is named, and the others are trained.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::fs;
use std::path::PathBuf;
use std::process::{Child, Command, Output, Stdio};

use protocol::run::RunFolder;
use system_tests::{PATIENCE, SMALL, Signal, Summary, TestRun, await_some, programs, send};

/// Writes a plan and gives the line that carries it out.
fn experiment(test: &TestRun) -> Command {
    let settings: Vec<_> = SMALL.iter().map(|setting| format!("{setting:?}")).collect();
    let plan = format!(
        "title = \"A test\"\nseeds = [1, 2]\nmethods = [\"goal-proximity\", \"environment-reward\"]\n\
         [[panel]]\nname = \"small\"\ntitle = \"Small\"\ntask = \"navigation\"\nset = [{}]\n",
        settings.join(", ")
    );
    fs::write(test.path("plan.toml"), plan).unwrap();
    let mut command = test.program("goalward");
    command.args(["experiment", "plan.toml", "--out", "all", "--jobs", "2"]);
    command
}

/// Folders of runs, each with its method and seed in its name.
fn folders(test: &TestRun) -> Vec<RunFolder> {
    let entries = fs::read_dir(test.path("all/runs")).into_iter().flatten().flatten();
    let mut paths: Vec<PathBuf> =
        entries.map(|entry| entry.path()).filter(|path| path.is_dir()).collect();
    paths.sort();
    paths.into_iter().map(RunFolder::new).collect()
}

fn text(output: &Output) -> String {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout.clone()).unwrap()
}

/// Waits for an experiment that is to end well.
fn end(experiment: Child) -> String {
    text(&experiment.wait_with_output().unwrap())
}

#[test]
fn what_is_missing_is_trained() {
    let test = TestRun::new(programs!());
    let begun = experiment(&test).stdout(Stdio::piped()).spawn().unwrap();
    let has_checkpoint = |folder: &RunFolder| folder.newest_checkpoint().is_some();
    await_some("a checkpoint", PATIENCE, || folders(&test).into_iter().find(has_checkpoint));
    send(begun.id(), Signal::Interrupt);
    let said = end(begun);
    assert!(said.contains("stopped; go on with"), "{said}");
    assert!(folders(&test).iter().any(|folder| !folder.summary_file().exists()), "{said}");

    let said = end(experiment(&test).stdout(Stdio::piped()).spawn().unwrap());
    assert_eq!(said.matches("2 of 2").count(), 2, "{said}");
    let finished = folders(&test);
    assert_eq!(finished.len(), 4);
    let summaries = |folder: &RunFolder| fs::read(folder.summary_file()).unwrap();
    let before: Vec<_> = finished.iter().map(summaries).collect();

    let said = text(&experiment(&test).output().unwrap());
    assert!(said.contains("report plan.toml --experiments all"), "{said}");
    assert_eq!(finished.iter().map(summaries).collect::<Vec<_>>(), before, "trained again");

    let named = |part: &str| {
        finished.iter().position(|folder| folder.path().to_str().unwrap().contains(part)).unwrap()
    };
    let ours = named("navigation-goal-proximity-s2-");
    let summary: Summary = serde_json::from_slice(&before[ours]).unwrap();
    assert_eq!(summary.hashes(), test.finish(&["seed=2"]).hashes());

    // One run's folder becomes one that holds something else; another run is gone.
    let spoilt = &finished[named("navigation-environment-reward-s1-")];
    for file in [spoilt.summary_file(), spoilt.config_file()] {
        fs::remove_file(file).unwrap();
    }
    fs::remove_dir_all(finished[ours].path()).unwrap();
    let output = experiment(&test).output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("found files") && said.contains("1 of 4 runs failed"), "{said}");
    assert!(finished[ours].summary_file().exists(), "the other one is trained: {said}");
}
