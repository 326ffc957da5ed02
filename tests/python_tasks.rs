//! Tasks that are Python environments, through the whole system.
//!
//! Method: small runs in the environments of `actor/tests/python_environments` and in public ones. The tests need the
//! packages of `tests/requirements.txt`; `GOALWARD_PYTHON=none` skips them.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::fs;

use run::folder::RunFolder;
use serde_json::Value;
use system_tests::{Hashes, Page, Signal, TestRun, programs, python, send};

const LINE: &str = "python:python_environments:line";

/// Creates a test folder in which Python finds the environments.
fn with_environments() -> TestRun {
    let run = TestRun::new(programs!());
    let environments = include_str!("../actor/tests/python_environments/__init__.py");
    fs::write(run.path("python_environments.py"), environments).unwrap();
    run
}

fn train(settings: &[&str], disturb: bool) -> (TestRun, Hashes) {
    let run = with_environments();
    let settings = [&["method=environment-reward"], settings].concat();
    let mut training = run.train_task(LINE, &settings);
    if disturb {
        training.await_checkpoint(2);
        run.process("actor-0").signal(Signal::Kill);
        run.process("learner").signal(Signal::Kill);
    }
    let summary = training.finish();
    assert_eq!((summary.task.as_str(), summary.iterations), ("line", 8));
    (run, summary.hashes())
}

#[test]
fn an_environment_of_python_is_trained_verified_and_imitated_like_any_task() {
    if python().is_none() {
        return;
    }
    let (run, alone) = train(&["resources.actors=1"], false);
    let (_, disturbed) = train(&["resources.actors=3"], true);
    assert_eq!(disturbed, alone, "the same bits whatever the number of actors and who is killed");
    let config = run.folder().config().unwrap();
    assert_eq!(config.task.labels, ["parity[0]", "parity[1]", "place"]);
    let versions = config.environment.0["versions"].as_table().unwrap();
    assert!(versions["gymnasium"].is_str() && !versions.contains_key("mujoco"), "{versions:?}");
    let folder = run.folder().path().to_str().unwrap().to_owned();
    for (arguments, words) in [
        (&["replay", &folder, "--verify"][..], "the same"),
        (&["replay", &folder, "--retrain", "--out", "again"], "the same"),
        (&["evaluate", &folder, "--episodes", "5"], "success"),
        (&["task", LINE, "--out", "line.toml"], "line.toml"),
        (
            &[
                "demonstrate",
                "line.toml",
                "--policy",
                &folder,
                "--episodes",
                "9",
                "--out",
                "d.mcap",
            ],
            "",
        ),
        (
            &[
                "train",
                "line.toml",
                "--demonstrations",
                "d.mcap",
                "--steps",
                "800",
                "--run",
                "imitator",
                "--set",
                "rollout.lanes=4",
                "--set",
                "rollout.lane_steps=100",
                "--set",
                "ppo.minibatches=2",
                "--set",
                "reward.batch=8",
                "--set",
                "evaluation.episodes=4",
            ],
            "policy sha256",
        ),
    ] {
        let (well, said) = run.goalward(arguments);
        assert!(well && said.contains(words), "{arguments:?}: {said}");
    }
    let imitator = RunFolder::new(run.path("imitator")).config().unwrap();
    assert_eq!((imitator.demonstrations.episodes, imitator.task.name.as_str()), (9, "line"));
}

#[test]
fn a_run_goes_on_in_the_environment_it_began_with() {
    if python().is_none() {
        return;
    }
    let run = with_environments();
    let settings = ["method=environment-reward", "steps=100000"];
    let mut training = run.train_task(LINE, &settings);
    training.await_checkpoint(2);
    training.signal(Signal::Interrupt);
    assert_eq!(training.end(), Some(130));
    let file = run.path("python_environments.py");
    let changed = fs::read_to_string(&file).unwrap().replace("- 0.15", "- 0.25");
    fs::write(&file, changed).unwrap();
    let (well, said) = run.goalward(&["train", "--resume", "--run", "run"]);
    assert!(!well && said.contains("`sources.python_environments`"), "{said}");
    let allowed = ["train", "--resume", "--other-build", "--run", "run", "--dry-run"];
    let (well, said) = run.goalward(&allowed);
    assert!(well && said.contains("would continue"), "{said}");

    let evaluation = ["evaluate", "run", "--episodes", "3"];
    let (well, said) = run.goalward(&evaluation);
    assert!(!well && said.contains("`sources.python_environments`"), "{said}");
    let (well, said) = run.goalward(&[&evaluation[..], &["--other-build"]].concat());
    assert!(well && said.contains("of 3 episodes"), "{said}");
}

#[test]
fn recorded_episodes_tell_whether_a_changed_module_matters() {
    if python().is_none() {
        return;
    }
    let (run, _) = train(&[], false);
    let file = run.path("python_environments.py");
    let module = fs::read_to_string(&file).unwrap();
    fs::write(&file, format!("{module}\n# the same environment\n")).unwrap();
    let (well, said) = run.goalward(&["replay", "run", "--verify"]);
    assert!(well && said.contains("the same"), "{said}");

    fs::write(&file, module.replace("- 0.15", "- 0.25")).unwrap();
    let (well, said) = run.goalward(&["replay", "run", "--verify"]);
    for words in ["episodes differ", "`sources.python_environments`"] {
        assert!(!well && said.contains(words), "expected {words} in {said}");
    }
}

#[test]
fn a_dry_run_lists_what_is_changed_in_an_environment_of_python() {
    if python().is_none() {
        return;
    }
    let run = with_environments();
    let mut arguments = vec!["train", LINE, "--dry-run", "--method", "environment-reward"];
    arguments.extend(["--set", "ppo.clip=0.3", "--set", "environment.kwargs.start=0.25"]);
    let (well, said) = run.goalward(&arguments);
    assert!(well, "{said}");
    for words in ["(default 0.2)", "environment.kwargs.start", "0.25"] {
        assert!(said.contains(words), "expected {words} in {said}");
    }
    assert!(!said.contains("task.") && !said.contains("versions"), "{said}");
}

#[test]
fn an_environment_of_python_renders_its_episodes() {
    if python().is_none() {
        return;
    }
    let (run, _) = train(&[], false);
    let page = Page::over(&run, &["."]);
    let episode = "/api/runs/run/episodes/log/3";
    assert_eq!(page.json("/api/runs/run")["renders"], true);
    assert_eq!(page.json(&format!("{episode}/scenes")), Value::Null);
    let states = page.json(episode)["steps"].as_u64().unwrap() + 1;
    let bytes = page.bytes(&format!("{episode}/pictures"));
    let (mut rest, mut found) = (&bytes[..], 0);
    while let Some((head, behind)) = rest.split_at_checked(8) {
        let [state, length] =
            [&head[..4], &head[4..]].map(|number| u32::from_le_bytes(number.try_into().unwrap()));
        assert_eq!(u64::from(state), found);
        assert!(behind.starts_with(b"\x89PNG"));
        (rest, found) = (&behind[length as usize..], found + 1);
    }
    assert_eq!((found, rest.len()), (states, 0), "a picture of every state");

    let (well, said) = run.goalward(&["log", "scene", "run", "0:0", "--out", "scene.mcap"]);
    assert!(well && said.contains("1 episodes"), "{said}");
    let (well, said) = run.goalward(&["log", "info", "scene.mcap"]);
    assert!(well && said.contains("/evaluation/image"), "{said}");
}

#[test]
fn fetch_push_gives_the_same_bits() {
    gives_the_same_bits("gym:gymnasium_robotics:FetchPush-v4", &[]);
}

#[test]
fn ant_gives_the_same_bits() {
    gives_the_same_bits("gym:Ant-v5", &["environment.horizon_steps=100"]);
}

#[test]
fn minigrid_gives_the_same_bits() {
    gives_the_same_bits("gym:minigrid:MiniGrid-FourRooms-v0", &[]);
}

/// Trains in a third-party environment with one, two and four actors. With four, an actor and another actor's child
/// process are killed, and the run is stopped and resumed. Finally its episodes are verified.
fn gives_the_same_bits(task: &str, settings: &[&str]) {
    if python().is_none() {
        return;
    }
    let settings = [&["method=environment-reward"], settings].concat();
    let with = |actors| [&settings[..], &[actors]].concat();
    let [alone, two] = ["resources.actors=1", "resources.actors=2"].map(|actors| {
        let run = TestRun::new(programs!());
        run.train_task(task, &with(actors)).finish().hashes()
    });
    assert_eq!(two, alone);

    let run = TestRun::new(programs!());
    let mut training = run.train_task(task, &with("resources.actors=4"));
    training.await_checkpoint(2);
    run.process("actor-0").signal(Signal::Kill);
    run.process("actor-1").children().into_iter().for_each(|child| send(child, Signal::Kill));
    training.await_checkpoint(4);
    training.signal(Signal::Interrupt);
    assert_eq!(training.end(), Some(130));
    assert_eq!(run.resume().finish().hashes(), alone, "killed, stopped and resumed");
    let remarks = run.remarks();
    assert!(remarks.contains("actor-0 ended (signal: 9"), "{remarks}");
    assert!(remarks.contains("actor-1 ended"), "{remarks}");

    let folder = run.folder().path().to_str().unwrap().to_owned();
    let (well, said) = run.goalward(&["replay", &folder, "--verify"]);
    assert!(well && said.contains("the same"), "{said}");
}

#[test]
fn an_expert_of_python_demonstrates_for_a_run_or_into_a_file() {
    if python().is_none() {
        return;
    }
    let run = with_environments();
    let expert = "python_environments:expert";
    let arguments = ["demonstrate", LINE, "--expert", expert, "--episodes", "9", "--out", "e.mcap"];
    let (well, said) = run.goalward(&arguments);
    assert!(well, "{said}");
    let file = format!("demonstrations.file={}", run.path("e.mcap").display());
    let by_file = run.train_task(LINE, &["reward.batch=8", &file]).finish();
    let other = with_environments();
    let by_itself = format!("demonstrations.expert={expert}");
    let settings = ["reward.batch=8", &by_itself, "demonstrations.episodes=9"];
    let by_itself = other.train_task(LINE, &settings);
    assert_eq!(by_itself.finish().hashes(), by_file.hashes(), "the same seed, the same episodes");
    let (well, said) = run.goalward(&["train", LINE, "--set", "demonstrations.expert=no:one"]);
    assert!(!well && said.contains("ModuleNotFoundError: No module named 'no'"), "{said}");
    assert!(!run.path("runs").exists(), "nothing is begun");
}

#[test]
fn what_an_environment_raises_ends_the_run_and_what_cannot_be_a_task_begins_none() {
    if python().is_none() {
        return;
    }
    let run = with_environments();
    let bad = "python:python_environments:bad";
    let train = |how: &str| {
        let how = format!("environment.kwargs.how={how}");
        let settings = ["--set", &how, "--set", "method=environment-reward"];
        run.goalward(&[&["train", bad, "--run", "bad", "--steps", "80000"], &settings[..]].concat())
    };
    let (well, said) = train("raises");
    assert!(!well && said.contains("ZeroDivisionError: by nothing"), "{said}");
    assert!(!run.path("bad").exists(), "what fails when it is looked at begins no run");
    let (well, said) = train("raises late");
    assert!(!well && said.contains("ZeroDivisionError: by nothing"), "{said}");
    assert!(said.contains("and would fail the same way again"), "{said}");
    let (well, said) = run.goalward(&["status", "bad"]);
    assert!(well && said.starts_with("failed: "), "{said}");
    for (arguments, words) in [
        (&["train", "gym:Nowhere-v0", "--run", "none"][..], "Nowhere"),
        (&["train", "python:python_environments:Picture", "--run", "none"], "images"),
        (&["train", LINE, "--run", "none"], "has no expert"),
        (&["task", "navigation", "--out", "t.toml"], "expected gym:ID"),
        (&["task", "gym:Nowhere-v0", "--out", "t.toml"], "Nowhere"),
    ] {
        let (well, said) = run.goalward(arguments);
        assert!(!well && said.contains(words), "{arguments:?}: {said}");
        assert!(!run.path("none").exists() && !run.path("t.toml").exists(), "{arguments:?}");
    }
}

#[test]
fn an_environment_without_a_success_signal_is_remarked_on_unless_that_was_asked_for() {
    if python().is_none() {
        return;
    }
    let run = with_environments();
    let pendulum = ["task", "gym:Pendulum-v1", "--out"];
    let remark = "Pendulum-v1: found no success signal";
    let (well, said) = run.goalward(&[&pendulum[..], &["found.toml"]].concat());
    assert!(well && said.contains(remark), "{said}");
    let asked_for = ["asked.toml", "--set", "environment.success=none"];
    let (well, said) = run.goalward(&[&pendulum[..], &asked_for].concat());
    assert!(well && !said.contains(remark), "{said}");
}

#[test]
fn the_keys_of_a_python_environment_are_listed() {
    if python().is_none() {
        return;
    }
    let run = with_environments();
    let (well, said) = run.goalward(&["config", "rollout.", "--task", "gym:Pendulum-v1"]);
    assert!(well && said.contains("rollout.lanes"), "{said}");
}
