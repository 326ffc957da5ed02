//! An external task: the crate in `deploy/examples/reacher`, which no part of goalward knows, is built by cargo as
//! its user would build it, and everything works with it as with a built-in task.
//!
//! Method: the crate's program is placed next to a copy of its task file, and small runs are trained in the task.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

use mcap_log::FileReader;
use run::metadata::recorded_task;
use run::summary::Summary as RunSummary;
use system_tests::{Hashes, Signal, TestRun, programs};

/// Builds the example's actor, if anything has changed, and returns its path. Cargo chooses other features of its
/// dependencies than in this workspace, so most are built again: unoptimized, because that takes a third of the time.
fn actor() -> &'static Path {
    static ACTOR: OnceLock<PathBuf> = OnceLock::new();
    ACTOR.get_or_init(|| {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
        let example = root.join("deploy/examples/reacher");
        // Use the dependency versions that are already here.
        fs::copy(root.join("Cargo.lock"), example.join("Cargo.lock")).unwrap();
        let target = Path::new(env!("CARGO_TARGET_TMPDIR")).parent().unwrap();
        let mut cargo = Command::new(env!("CARGO"));
        cargo.args(["build", "--offline", "--quiet", "--target-dir"]).arg(target);
        cargo.env("CARGO_PROFILE_DEV_OPT_LEVEL", "0").env("CARGO_PROFILE_DEV_DEBUG", "none");
        let built = cargo.current_dir(&example).output().unwrap();
        assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
        target.join("debug/reacher")
    })
}

const REACHER: &str = include_str!("../deploy/examples/reacher/reacher.toml");

/// Creates a test folder with the task file `text`, in which only the program's path is changed.
fn with_task(text: &str) -> (TestRun, String) {
    let run = TestRun::new(programs!());
    fs::hard_link(actor(), run.path("bin/reacher")).unwrap();
    let own = text.replace("\"target/release/reacher\"", "\"bin/reacher\"");
    assert_ne!(own, text);
    let file = run.path("reacher.toml");
    fs::write(&file, own).unwrap();
    (run, file.to_str().unwrap().to_owned())
}

fn train(settings: &[&str], disturb: bool) -> (TestRun, Hashes) {
    let (run, file) = with_task(REACHER);
    let mut training = run.train_task(&file, settings);
    if disturb {
        training.await_checkpoint(2);
        run.process("actor-0").signal(Signal::Kill);
        run.process("learner").signal(Signal::Kill);
    }
    let summary = training.finish();
    assert_eq!((summary.task.as_str(), summary.iterations), ("reacher", 8));
    (run, summary.hashes())
}

#[test]
fn a_task_from_outside_is_trained_verified_and_drawn_like_any_other() {
    let (run, alone) = train(&["resources.actors=1"], false);
    let (_, disturbed) = train(&["resources.actors=3"], true);
    assert_eq!(disturbed, alone, "the same bits whatever the number of actors and who is killed");

    let config = run.folder().config().unwrap();
    assert_eq!(config.task.program_sha256.as_ref().map(String::len), Some(64));
    let demonstrations = FileReader::open(&run.folder().demonstrations_file()).unwrap();
    let recorded = recorded_task(demonstrations.metadata()).unwrap();
    assert_eq!((recorded.name.as_str(), recorded.spec()), ("reacher", config.task.spec()));
    assert_eq!(
        demonstrations.metadata().get("setting"),
        Some("{\"coverage\":0.5,\"step_ms\":0.0}")
    );

    for (arguments, words) in [
        (&["replay", "run", "--verify"][..], "the same"),
        (&["replay", "run", "--retrain"], "the same"),
        (&["evaluate", "run", "--episodes", "5"], "of 5 episodes"),
        (&["report", "run"], "index.html"),
        (&["train", "reacher.toml", "--dry-run", "--set", "ppo.clip=0.3"], "(default 0.2)"),
    ] {
        let (success, said) = run.goalward(arguments);
        assert!(success, "{arguments:?}: {said}");
        assert!(said.contains(words), "{arguments:?}: expected {words} in {said}");
    }
    let page = fs::read_to_string(run.path("report/index.html")).unwrap();
    assert!(page.contains("REACHER") && page.contains("goalward train run/config.toml"));
}

#[test]
fn what_does_not_fit_the_task_s_environment_is_refused_before_there_is_a_run() {
    let (run, file) = with_task(REACHER);
    let text = fs::read_to_string(&file).unwrap();
    for (sound, spoilt, settings, words) in [
        ("", "", &["environment.coverage=2"][..], &["`environment.coverage`", "at most 1"][..]),
        ("", "", &["demonstrations.coverage=0"], &["`demonstrations.coverage`", "above 0"]),
        ("", "", &["environment.wind=3"], &["`environment`", "wind", "coverage"]),
        ("{ len = 8 }", "{ len = 9 }", &[], &["`task.observation`", "len: 8", "len: 9"]),
        ("{ len = 2 }", "{ len = 3 }", &[], &["`task.action`"]),
        ("horizon_steps = 60", "horizon_steps = 50", &[], &["`task.horizon_steps`", "60"]),
        ("horizon_steps = 60", "horizon = 60", &[], &["horizon"]),
        ("name = \"reacher\"", "name = \"grabber\"", &[], &["grabber", "known tasks: reacher"]),
        ("name = \"reacher\"", "name = \"../reacher\"", &[], &["`task.name`", "letters"]),
        ("bin/reacher", "bin/grabber", &[], &["bin/grabber", "No such file"]),
        ("[task]", "task = \"reacher\"\n[other]", &[], &["table `task`"]),
    ] {
        fs::write(&file, text.replacen(sound, spoilt, 1)).unwrap();
        let settings = settings.iter().flat_map(|setting| ["--set", setting]);
        let arguments: Vec<&str> =
            ["train", &file, "--run", "run"].into_iter().chain(settings).collect();
        let output = run.program("goalward").args(arguments).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{spoilt}: {said}");
        assert_eq!(said.lines().count(), 1, "{spoilt}: {said}");
        for word in words {
            assert!(said.contains(word), "{spoilt}: expected {word} in {said}");
        }
        assert!(!run.folder().path().exists(), "{spoilt}");
    }
}

#[test]
fn a_run_goes_on_with_the_program_it_began_with() {
    let (run, file) = with_task(REACHER);
    let mut training = run.train_task(&file, &["steps=100000"]);
    training.await_checkpoint(2);
    training.signal(Signal::Interrupt);
    assert_eq!(training.end(), Some(130));
    fs::remove_file(run.path("bin/reacher")).unwrap();
    let mut other = fs::read(actor()).unwrap();
    other.push(0);
    fs::write(run.path("bin/reacher"), other).unwrap();
    let (success, said) = run.goalward(&["train", "--resume", "--run", "run"]);
    assert!(!success && said.contains("expected the program that the run began with"), "{said}");
}

#[test]
fn a_task_that_cannot_tell_success_is_judged_by_return() {
    let held = include_str!("../deploy/examples/reacher/reacher_held.toml");
    let (run, file) = with_task(held);
    assert_eq!(run.train_task(&file, &[]).end(), Some(0), "{}", run.remarks());
    let summary = RunSummary::of_run(&run.folder()).unwrap().unwrap();
    assert_eq!((summary.success_rate, summary.evaluation.success_rate), (None, None));
    assert!(summary.evaluation.mean_return.is_some_and(|mean| mean < 0.0));
    for arguments in [&["status", "run"][..], &["evaluate", "run"], &["report", "run"]] {
        let (success, said) = run.goalward(arguments);
        assert!(success && !said.contains("NaN"), "{arguments:?}: {said}");
    }
    let page = fs::read_to_string(run.path("report/index.html")).unwrap();
    assert!(!page.contains("NaN") && page.contains("\nproximity\n"));

    // The arm without `-held` does tell success; a task file that denies it is refused.
    fs::write(&file, fs::read_to_string(&file).unwrap().replace("-held", "")).unwrap();
    let (success, said) = run.goalward(&["train", &file]);
    assert!(!success && said.contains("`task.tells_success` must be true"), "{said}");
}
