//! Log files and users' commands: files of a live run are left alone, and a command that reads a file without its
//! end does not report success.
//!
//! Method: `goalward` is called on a run that is being trained, from various working directories and through links,
//! and on a finished run whose files are truncated.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::fs;
use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::Output;

use system_tests::{Signal, TestRun, programs};

const REWARDED: &str = "method=environment-reward";

/// Runs `goalward` in `folder`; returns its exit code and what it printed.
fn goalward(run: &TestRun, folder: &Path, arguments: &[&str]) -> (Option<i32>, String) {
    let mut command = run.program("goalward");
    let Output { status, stdout, stderr } =
        command.args(arguments).current_dir(folder).output().unwrap();
    let said = [stdout, stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
    (status.code(), said.concat())
}

#[test]
fn a_live_run_is_repaired_from_nowhere() {
    let run = TestRun::new(programs!());
    let mut training = run.train(&[REWARDED, "steps=4000000"]);
    training.await_checkpoint(4);
    let (folder, log) = (run.folder(), run.folder().log());
    let name = "trajectories-00000.mcap.active";
    let file = log.join(name);
    symlink(&file, run.path("link.mcap.active")).unwrap();
    symlink(&log, run.path("logs")).unwrap();
    fs::hard_link(&file, run.path("other.mcap.active")).unwrap();
    let stands: [(&Path, &str); 7] = [
        (&log, name),
        (folder.path(), "log/trajectories-00000.mcap.active"),
        (folder.path(), "."),
        (&run.path(""), "run"),
        (&run.path(""), "link.mcap.active"),
        (&run.path("logs"), name),
        (&run.path(""), "other.mcap.active"),
    ];
    for (place, named) in stands {
        let (code, said) = goalward(&run, place, &["log", "repair", named]);
        let words = ["being trained right now", "being written"];
        assert_eq!(code, Some(2), "{named} in {}: {said}", place.display());
        assert!(words.iter().any(|words| said.contains(words)), "{named}: {said}");
        assert!(file.exists() && !log.join("trajectories-00000.mcap").exists(), "{named}");
    }
    let (code, said) = goalward(&run, folder.path(), &["log", "info", "."]);
    assert_eq!(code, Some(0), "unsealed files of a live run have lost nothing: {said}");
    training.await_checkpoint(8);
    training.signal(Signal::Interrupt);
    assert_eq!(training.end(), Some(130));
    let (code, said) = goalward(&run, &log, &["log", "info", "trajectories-00000.mcap"]);
    assert_eq!(code, Some(0), "{said}");
}

#[test]
fn a_file_that_lost_its_end_is_no_success() {
    let run = TestRun::new(programs!());
    run.finish(&[REWARDED]);
    let folder = run.folder();
    let (shown, home) = (folder.path().to_str().unwrap(), run.path(""));
    let file = folder.log().join("trajectories-00000.mcap");
    let whole = fs::read(&file).unwrap();
    // After the last chunk and its indexes, and within a chunk.
    let data_end = whole.windows(9).rposition(|bytes| bytes == [0x0f, 4, 0, 0, 0, 0, 0, 0, 0]);
    for at in [data_end.unwrap(), whole.len() / 2] {
        fs::write(&file, &whole[..at]).unwrap();
        for command in [&["log", "info"][..], &["replay", "--verify"], &["replay", "--retrain"]] {
            let (code, said) = goalward(&run, &home, &[command, &[shown]].concat());
            assert_eq!(code, Some(3), "{command:?} at {at}: {said}");
            assert!(said.contains("cut off"), "{command:?} at {at}: {said}");
        }
    }
    let (code, said) = goalward(&run, &home, &["log", "repair", shown]);
    assert_eq!(code, Some(3), "{said}");
    let (code, said) = goalward(&run, &home, &["log", "info", shown]);
    assert_eq!(code, Some(0), "what is left is whole: {said}");
    let original = file.with_extension("mcap.damaged");
    assert!(said.contains(&format!("the original is {}", original.display())), "{said}");
    // Only the beginning of a file is left, then a file without episodes.
    fs::write(&file, &whole[..20]).unwrap();
    let (code, said) = goalward(&run, &home, &["log", "info", shown]);
    assert_eq!(code, Some(3), "{said}");
    let (code, said) = goalward(&run, &home, &["replay", "--verify", shown]);
    assert_eq!(code, Some(1), "{said}");
    let first_chunk = whole.windows(9).position(|bytes| bytes[0] == 6 && bytes[5..] == [0; 4]);
    fs::write(file.with_extension("mcap.active"), &whole[..first_chunk.unwrap()]).unwrap();
    fs::remove_file(&file).unwrap();
    let (code, said) = goalward(&run, &home, &["replay", "--verify", shown]);
    assert_eq!(code, Some(3), "{said}");
    assert!(said.contains("as summary.json has them, found 0"), "{said}");
}

#[test]
fn what_came_before_a_file_that_is_refused_is_told() {
    let run = TestRun::new(programs!());
    run.finish(&[]);
    let file = "run/log/updates-00000.mcap";
    for verb in ["info", "repair"] {
        let (well, said) = run.goalward(&["log", verb, file, "nowhere.mcap"]);
        assert!(!well && said.contains("nowhere.mcap"), "{said}");
        assert!(said.starts_with(file) || said.contains("updates-00000.mcap: kept"), "{said}");
    }
}
