//! The live page in a real browser: what people see and do there.
//!
//! Method: `page_browser.py` drives Chromium over real runs: finished, live, damaged, and one whose task does not tell
//! success. The test needs Chromium, its driver and the packages of `tests/requirements.txt`. Without the driver it
//! prints a line and is skipped, as it is with `GOALWARD_PYTHON=none`. `GOALWARD_PICTURES` names a folder for
//! screenshots.
#![allow(clippy::unwrap_used, clippy::print_stderr, reason = "a test ends at the first surprise")]

use std::fs;
use std::process::Command;

use system_tests::{Page, Signal, TestRun, programs};

/// Chromium's driver, where Debian's package installs it.
const DRIVER: &str = "/usr/bin/chromedriver";

fn python() -> Option<String> {
    let python = system_tests::python()?;
    if !fs::exists(DRIVER).unwrap() {
        eprintln!("left out: {DRIVER} is not there (apt-get install chromium chromium-driver)");
        return None;
    }
    Some(python)
}

#[test]
fn people_see_runs_curves_and_episodes() {
    let Some(python) = python() else { return };
    let run = TestRun::new(programs!());
    let train = |task, name: &str, settings: &[&str]| {
        run.train_task(task, settings).finish();
        fs::rename(run.path("run"), run.path(&format!("runs/{name}"))).unwrap();
    };
    fs::create_dir(run.path("runs")).unwrap();
    train("navigation", "navigation", &[]);
    for task in ["fetch-pick", "fetch-push", "ant-reach"] {
        train(task, task, &[]);
    }
    train("navigation", "damaged", &["seed=2"]);
    let file = run.path("runs/damaged/log/trajectories-00000.mcap");
    let bytes = fs::read(&file).unwrap();
    fs::write(&file, &bytes[..bytes.len() / 2]).unwrap();
    train("navigation", "untold", &["seed=3"]);
    let file = run.path("runs/untold/config.toml");
    let told = fs::read_to_string(&file).unwrap();
    fs::write(&file, told.replace("[task]\n", "[task]\ntells_success = false\n")).unwrap();

    let mut live = run.train(&["steps=4000000"]);
    live.await_checkpoint(4);
    let page = Page::over(&run, &["runs", "run"]);
    let see = |part: &str| {
        let mut script = Command::new(&python);
        script.arg(concat!(env!("CARGO_MANIFEST_DIR"), "/page_browser.py"));
        script.arg(page.url()).arg(part);
        if let Ok(folder) = std::env::var("GOALWARD_PICTURES") {
            script.args(["--pictures", &folder]);
        }
        let output = script.output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{said}");
        eprintln!("{}", String::from_utf8_lossy(&output.stdout));
    };
    see("live");
    live.signal(Signal::Interrupt);
    live.end();
    fs::remove_dir_all(run.path("run")).unwrap();
    let long = ["method=bc", "cloning.epochs=100000", "cloning.patience=100000"];
    let mut cloning = run.train(&long);
    cloning.await_checkpoint(4);
    see("cloning");
    // The other checks get the processors to themselves.
    cloning.signal(Signal::Interrupt);
    cloning.end();
    see("finished");
}
