//! The listings of `goalward`, for people and as JSON for programs, and stopping a run by name.
//!
//! Method: a real run is inspected while it trains, after `goalward stop` and at its end.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::path::Path;

use mcap_log::{FileReader, Record};
use protocol::trajectory::Encoded;
use serde_json::Value;
use system_tests::{SMALL, TestRun, programs, spec};

/// Returns what a verb prints with `--json`.
fn json(run: &TestRun, arguments: &[&str]) -> Value {
    let output = run.program("goalward").args(arguments).arg("--json").output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success() && said.is_empty(), "{arguments:?}: {said}");
    serde_json::from_slice(&output.stdout).unwrap()
}

/// Reads the run seeds of the episodes in a NAVIGATION evaluation file.
fn seeds(file: &Path) -> Vec<u64> {
    let seed = |record| match record {
        Record::EvaluationTrajectory(bytes) => {
            Some(Encoded::decode(bytes, &spec("navigation")).unwrap().trajectory.run_seed)
        }
        _ => None,
    };
    FileReader::open(file).unwrap().filter_map(|entry| seed(entry.unwrap().record)).collect()
}

#[test]
fn a_run_is_listed_stopped_continued_and_evaluated() {
    let run = TestRun::new(programs!());
    let here = run.path("").to_str().unwrap().to_owned();
    let listed = || json(&run, &["runs", &here])[0].clone();
    let (well, nothing) = run.goalward(&["runs", &here]);
    assert!(well && nothing.contains("no runs in"), "{nothing}");

    let mut training = run.train(&["steps=40000"]);
    training.await_checkpoint(4);
    let line = listed();
    assert_eq!((&line["state"], &line["task"]), (&"training".into(), &"navigation".into()));
    let status = json(&run, &["status", "run"]);
    assert_eq!((&status["state"], &status["trouble"]), (&"training".into(), &Value::Null));
    assert!(status["progress"]["update"]["environment_steps"].as_u64() > Some(0), "{status}");
    assert_eq!(status["processes"][0]["process"], "supervisor");
    assert!(status["checkpoint"]["iteration"].as_u64() >= Some(4), "{status}");
    assert!(line["environment_steps"].as_u64() > Some(0), "{line}");
    let (well, said) = run.goalward(&["stop", "run"]);
    assert!(well && said.contains("train --resume --run run"), "{said}");
    assert_eq!(training.end(), Some(130));
    assert_eq!(listed()["state"], "stopped");
    let status = json(&run, &["status", "run"]);
    assert_eq!(status["state"], "stopped");
    assert!(status["checkpoint"]["iteration"].as_u64() >= Some(4), "{status}");
    let (well, said) = run.goalward(&["stop", "run"]);
    assert!(
        !well && said.contains("expected a run that is training, found one that is not"),
        "{said}"
    );

    let summary = run.resume().finish();
    let line = listed();
    assert_eq!(line["state"], "finished");
    assert_eq!(line["environment_steps"], summary.environment_steps);
    let (well, table) = run.goalward(&["runs", &here]);
    assert!(well && table.contains("finished") && table.contains("navigation"), "{table}");
    let twice = json(&run, &["runs", "run", &here]);
    assert_eq!(twice.as_array().unwrap().len(), 2, "a run, and the folder that contains it");

    assert_eq!(
        json(&run, &["status", "run"])["summary"]["environment_steps"],
        summary.environment_steps
    );
    let told = json(&run, &["-q", "train", "--resume", "--run", "run"]);
    assert_eq!(
        (&told["policy_sha256"], &told["run"]),
        (&summary.policy_sha256.into(), &"run".into())
    );
    let evaluation = json(&run, &["evaluate", "run", "--episodes", "3"]);
    assert_eq!(evaluation["episodes"], 3);
    let other = json(&run, &["evaluate", "run", "--episodes", "3", "--seed", "77"]);
    let [own, other] = [evaluation, other].map(|one| run.path(one["file"].as_str().unwrap()));
    assert_eq!((seeds(&own), seeds(&other)), (vec![1; 3], vec![77; 3]));
    assert!(other.to_string_lossy().ends_with("-3-sample-seed77.mcap"), "{}", other.display());
    let (well, said) = run.goalward(&["evaluate", "run", "--episodes", "3", "--seed", "1"]);
    assert!(!well && said.contains("-3-sample.mcap exists"), "{said}");
    let first = run.folder().checkpoint_folders()[0].0;
    let shown = first.to_string();
    let chosen = ["evaluate", "run", "--episodes", "3", "--out", "e.mcap", "--checkpoint", &shown];
    let chosen = json(&run, &chosen);
    assert_eq!((&chosen["policy_version"], &chosen["file"]), (&first.into(), &"e.mcap".into()));
    assert_eq!(seeds(&run.path("e.mcap")), vec![1; 3]);
    let (well, said) = run.goalward(&["evaluate", "run", "--checkpoint", "99999"]);
    assert!(!well && said.contains("expected one of the checkpoints"), "{said}");
    let exported = json(&run, &["export", "run"]);
    assert_eq!(exported.as_array().unwrap().len(), 2);
    assert_eq!(exported[0]["of"], "policy");
}

#[test]
fn recorded_demonstrations_are_told_as_figures() {
    let run = TestRun::new(programs!());
    let recorded = ["demonstrate", "navigation", "--episodes", "3", "--out", "d.mcap"];
    let recorded = json(&run, &recorded);
    assert_eq!((&recorded["episodes"], &recorded["failures"]), (&3.into(), &0.into()));
    assert!(recorded["steps"].as_u64() >= Some(3) && recorded["file"] == "d.mcap", "{recorded}");
}

#[test]
fn a_log_of_actions_only_is_told_as_figures() {
    let run = TestRun::new(programs!());
    let summary = run.finish(&["log.observations=false"]);
    let other = json(&run, &["-q", "replay", "run", "--with", "reward.uncertainty=0.5"]);
    assert_eq!(other["episodes"], summary.episodes);
}

#[test]
fn a_log_is_told_as_figures() {
    let run = TestRun::new(programs!());
    let summary = run.finish(&[]);
    let files = json(&run, &["log", "info", "run"]);
    let messages = files[0]["messages"]["/trajectory"].as_u64();
    assert!(messages >= Some(summary.episodes) && files[0]["lost"] == false, "{files}");
    let (well, said) = run.goalward(&["log", "scene", "run", "99:0", "--out", "scene.mcap"]);
    assert!(!well && said.contains("run: expected an episode 99:0, found lanes 0 to "), "{said}");
    let (well, said) = run.goalward(&["log", "scene", "run", "0:0", "--out", "scene.mcap"]);
    assert!(!well && said.contains("navigation has no solids to draw"), "{said}");
    assert!(!run.path("scene.mcap").exists());
    let out = run.path("log").to_str().unwrap().to_owned();
    assert_eq!(json(&run, &["log", "restore", "run", "--out", &out])["restored"], 0);
    let verified = json(&run, &["-q", "replay", "run", "--verify"]);
    assert_eq!(verified["equal"], verified["episodes"]);
    let other = json(&run, &["-q", "replay", "run", "--with", "reward.uncertainty=0.5"]);
    assert_eq!(other["episodes"], summary.episodes);
    let again = json(&run, &["-q", "replay", "run", "--retrain"]);
    assert_eq!(again["policy_sha256"], summary.policy_sha256);
    assert_eq!(again["reward_model_sha256"], summary.reward_model_sha256);
}

#[test]
fn standard_output_has_results_alone_and_a_quiet_command_nothing_else() {
    let run = TestRun::new(programs!());
    let mut train = run.program("goalward");
    train.args(["-q", "train", "--no-page", "--json", "--run", "run", "--tensorboard", "events"]);
    for setting in SMALL.iter().chain(&["steps=1600"]) {
        train.args(["--set", setting]);
    }
    let output = train.output().unwrap();
    assert!(output.status.success() && output.stderr.is_empty(), "{output:?}");
    let summary: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(summary["task"], "navigation");
    let events = std::fs::read(run.path("events/run/events.out.tfevents.goalward")).unwrap();
    let tag = b"evaluation/success_rate";
    assert!(events.windows(tag.len()).any(|window| window == tag));
    let (well, _) = run.goalward(&["report", "run", "--out", "r", "--tensorboard", "again"]);
    let again = std::fs::read(run.path("again/run/events.out.tfevents.goalward")).unwrap();
    assert!(well && again == events, "a finished run has the same event file");

    let (well, said) = run.goalward(&["-v", "evaluate", "run", "--episodes", "2"]);
    assert!(well && said.contains("starting ") && said.contains("goalward-actor"), "{said}");
    for (color, has_escape) in [("always", true), ("never", false), ("auto", false)] {
        let (well, said) = run.goalward(&["--color", color, "status", "nowhere"]);
        assert!(!well && said.contains('\x1b') == has_escape, "{color}: {said:?}");
    }
}

#[test]
fn tasks_and_methods_are_those_that_are_trained() {
    let run = TestRun::new(programs!());
    let tasks = json(&run, &["tasks"]);
    let names: Vec<_> = tasks.as_array().unwrap().iter().map(|task| &task["name"]).collect();
    assert_eq!(names, ["navigation", "fetch-pick", "fetch-push", "ant-reach"]);
    let methods = json(&run, &["methods"]);
    let needs = |name: &str| {
        let found = methods.as_array().unwrap().iter().find(|method| method["name"] == name);
        found.unwrap()["needs_actions"].as_bool().unwrap()
    };
    assert!(needs("gail") && needs("bc") && !needs("goal-proximity") && !needs("bco"));
    for (verb, part) in [("tasks", "19 x 19 cells"), ("methods", "discriminator of transitions")] {
        let (well, table) = run.goalward(&[verb]);
        assert!(well && table.contains(part), "{table}");
    }
}

#[test]
fn a_folder_that_is_none_is_refused() {
    let run = TestRun::new(programs!());
    let (well, said) = run.goalward(&["runs", "nowhere"]);
    assert!(!well && said.contains("nowhere: expected a folder of runs"), "{said}");
}

#[test]
fn keys_are_listed_with_their_values_and_what_is_said_of_them() {
    let run = TestRun::new(programs!());
    let (well, said) = run.goalward(&["config", "ppo.gamma", "delta", "--task", "fetch-push"]);
    assert!(well, "{said}");
    let gamma = said.lines().find(|line| line.contains("ppo.gamma ")).unwrap();
    assert!(gamma.contains("0.99") && gamma.contains("Table 2"), "{said}");
    assert!(said.contains("reward.delta") && !said.contains("reward.batch"), "{said}");
    let (well, said) = run.goalward(&["config", "--json", "--preset", "paper"]);
    let keys: serde_json::Value = serde_json::from_str(&said).unwrap();
    assert!(well && keys.as_array().unwrap().len() > 60, "{said}");
    let (well, said) = run.goalward(&["config", "wings"]);
    assert!(!well && said.contains("found wings"), "{said}");
}

#[test]
fn a_dry_run_says_what_would_be_trained_and_leaves_nothing() {
    let run = TestRun::new(programs!());
    let arguments = ["train", "navigation", "--dry-run", "--run", "run", "--set", "ppo.clip=0.3"];
    let (well, said) = run.goalward(&arguments);
    assert!(
        well && said.starts_with("would train navigation with goal-proximity in run"),
        "{said}"
    );
    assert!(said.contains("ppo.clip") && said.contains("(default 0.2)"), "{said}");
    assert!(said.contains("processor time") && !said.contains("environment."), "{said}");
    assert!(!run.path("run").exists());
    let (well, said) =
        run.goalward(&["train", "--dry-run", "--run", "run", "--set", "ppo.clip=-1"]);
    assert!(!well && said.contains("ppo.clip"), "{said}");
}

#[test]
fn shells_and_man_know_the_command_line() {
    let run = TestRun::new(programs!());
    let (well, said) = run.goalward(&["completions", "bash"]);
    assert!(well && said.contains("--dry-run") && said.contains("_goalward"), "{said}");
    let (well, said) = run.goalward(&["manual", "--out", "man"]);
    assert!(well, "{said}");
    let page = std::fs::read_to_string(run.path("man/goalward-train.1")).unwrap();
    assert!(page.starts_with(".ie") && page.contains("Environment steps to train for"), "{page}");
}
