//! The output that people see: on a terminal, on one that cannot redraw a line, and in a pipe.
//!
//! Method: the test opens a pseudoterminal and reads what a real program shows on it.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::fs::{self, File, OpenOptions, Permissions};
use std::io::Read;
use std::os::unix::fs::PermissionsExt;
use std::process::Command;

use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use system_tests::{SMALL, TestRun, programs};

/// Runs a command, which must succeed, on a terminal of type `term`; returns everything that it showed.
fn on_terminal(mut command: Command, term: &str) -> String {
    let own_end = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
    grantpt(&own_end).unwrap();
    unlockpt(&own_end).unwrap();
    let name = ptsname(&own_end, Vec::new()).unwrap().into_string().unwrap();
    let terminal = OpenOptions::new().read(true).write(true).open(name).unwrap();
    command.stdout(terminal.try_clone().unwrap()).stderr(terminal).env("TERM", term);
    let mut started = command.spawn().unwrap();
    // The command holds ends of the terminal; reading stops with an error when the last of them is closed.
    drop(command);
    let mut shown = Vec::new();
    File::from(own_end).read_to_end(&mut shown).ok();
    let shown = String::from_utf8_lossy(&shown).into_owned();
    assert!(started.wait().unwrap().success(), "{shown}");
    shown
}

fn training(run: &TestRun) -> Command {
    let mut command = run.program("goalward");
    command.args(["train", "navigation", "--run", "run"]);
    for setting in SMALL.iter().chain(&["steps=1600"]) {
        command.args(["--set", setting]);
    }
    command
}

#[test]
fn a_terminal_that_cannot_redraw_a_line_gets_lines() {
    let run = TestRun::new(programs!());
    let mut training = training(&run);
    training.env("CI", "true");
    let shown = on_terminal(training, "dumb");
    for part in ["recording 40 demonstrations", "starting the processes", "/1,600 steps  "] {
        assert!(shown.contains(part), "expected {part} in\n{shown}");
    }
    assert!(!shown.contains('\x1b'), "{shown:?}");
}

#[test]
fn what_is_done_for_long_shows_how_far_it_is() {
    let run = TestRun::new(programs!());
    let mut demonstrate = run.program("goalward");
    demonstrate.args(["demonstrate", "navigation", "--episodes", "60000", "--out", "d.mcap"]);
    let shown = on_terminal(demonstrate, "xterm");
    let percent = shown.split(" %").filter_map(|part| part.rsplit(' ').next()?.parse::<u64>().ok());
    let percent: Vec<u64> = percent.collect();
    assert!(percent.len() > 1 && percent.is_sorted(), "expected percents in\n{shown}");
    assert!(shown.contains("recording demonstrations: ") && shown.contains("steps/s"), "{shown}");

    training(&run).output().unwrap();
    let mut evaluate = run.program("goalward");
    evaluate.args(["evaluate", "run", "--episodes", "200"]);
    let shown = on_terminal(evaluate, "xterm");
    assert!(shown.contains("evaluating: ") && shown.contains(" of 200 episodes"), "{shown}");
    assert!(shown.contains("steps per episode"), "{shown}");
}

#[test]
fn a_failure_has_one_form_whoever_fails() {
    let run = TestRun::new(programs!());
    training(&run).output().unwrap();
    fs::remove_dir_all(run.path("run/checkpoints")).unwrap();
    let failed = run.program("goalward").args(["evaluate", "run"]).output().unwrap();
    let said = String::from_utf8(failed.stderr).unwrap();
    assert!(!failed.status.success() && said.starts_with("goalward: "), "{said}");
    assert_eq!(said.lines().count(), 1, "{said}");
}

#[test]
fn the_programs_of_a_quiet_command_say_errors_only() {
    let run = TestRun::new(programs!());
    let actor = run.path("bin/goalward-actor");
    fs::remove_file(&actor).unwrap();
    fs::write(&actor, "#!/bin/sh\necho level ${RUST_LOG:-info} >&2\nexit 1\n").unwrap();
    fs::set_permissions(&actor, Permissions::from_mode(0o755)).unwrap();
    let said = |flags: &[&str]| {
        let mut command = run.program("goalward");
        command.args(flags).args(["demonstrate", "navigation", "--episodes", "3"]);
        let ended = command.args(["--out", "d.mcap"]).output().unwrap();
        String::from_utf8(ended.stderr).unwrap()
    };
    assert_eq!(said(&[]), "level info\n");
    assert_eq!(said(&["--quiet"]), "level error\n");
}
