//! Every method through the whole system: it trains, gives the same bits whichever process is killed, and can be
//! trained again from its log.
//!
//! Method: small runs of the real programs, compared by the hashes of `summary.json`.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]
#![allow(clippy::print_stdout, reason = "hashes are compared by whoever asks for them")]

use std::fs;

use mcap_log::{FileWriter, Kind, Metadata, Topic};
use protocol::trajectory::Encoded;
use system_tests::{Hashes, ITERATIONS, Signal, Summary, TASKS, TestRun, programs, read_by};

/// Settings that make the imitation learners small: method, kind of task (grid, physics or, if empty, both), settings.
const SMALL_LEARNERS: [(&str, &str, &[&str]); 6] = [
    ("bc", "", &["cloning.epochs=5", "evaluation.episodes=8"]),
    ("bco", "", &["inverse_dynamics.samples=128", "inverse_dynamics.exploration_steps=800"]),
    (
        "bco",
        "grid",
        &["inverse_dynamics.convolution_channels=[4, 8, 8]", "inverse_dynamics.features=16"],
    ),
    ("bco", "physics", &["inverse_dynamics.hidden=[16, 16]"]),
    ("sqil", "", &["sqil.batch=8", "sqil.updates_per_step=0.05", "sqil.exploration_steps=800"]),
    ("sqil", "physics", &["sqil.hidden=[16, 16]"]),
];

fn settings(method: &str, task: &str) -> Vec<String> {
    let kind = if task == "navigation" { "grid" } else { "physics" };
    let own = SMALL_LEARNERS
        .iter()
        .filter(|(name, only, _)| *name == method && (only.is_empty() || *only == kind));
    let own = own.flat_map(|(_, _, settings)| *settings).copied();
    let name = format!("method={method}");
    let all = own.chain(read_by(method, &["reward.batch=32"])).chain([name.as_str()]);
    all.map(str::to_owned).collect()
}

fn train(run: &TestRun, task: &str, method: &str) -> Summary {
    let settings = settings(method, task);
    let settings: Vec<&str> = settings.iter().map(String::as_str).collect();
    run.train_task(task, &settings).finish()
}

/// Returns the names of all methods.
fn all_methods() -> Vec<String> {
    let methods: toml::Table = include_str!("../deploy/methods.toml").parse().unwrap();
    methods.keys().cloned().collect()
}

#[test]
fn every_method_trains_and_evaluates() {
    // On physics, those that differ in more than settings.
    let on_physics = [
        "gaifo-s-uncertainty",
        "gaifo-next-state",
        "gaifo",
        "ranking",
        "temporal-distance",
        "proximity-with-actions",
        "nearest-state",
        "segment-matching",
        "proximity-discriminator",
        "bc",
        "bco",
        "sqil",
    ];
    let on_physics = on_physics.map(str::to_owned).to_vec();
    for (task, methods) in [("navigation", all_methods()), ("fetch-push", on_physics)] {
        for method in &methods {
            let summary = train(&TestRun::new(programs!()), task, method);
            let wanted = if method == "bc" { 0 } else { 3200 };
            assert!(
                summary.environment_steps >= wanted,
                "{task} {method}: {} steps",
                summary.environment_steps
            );
            let expected = if task == "navigation" { 8 } else { 4 + 4 * u64::from(method == "bc") };
            assert_eq!(summary.evaluation.episodes, expected, "{task} {method}");
        }
    }
}

/// A change that should not affect results must leave these lines unchanged.
#[test]
#[ignore = "minutes; prints what two builds are compared by"]
fn hashes() {
    for task in TASKS {
        for method in all_methods() {
            let Hashes { policy, proximity } =
                train(&TestRun::new(programs!()), task, &method).hashes();
            println!("hashes {task} {method} {policy} {proximity}");
        }
    }
}

#[test]
fn whoever_is_killed_learns_the_same() {
    for method in ["gail", "bco", "sqil"] {
        let undisturbed = train(&TestRun::new(programs!()), "navigation", method);
        let run = TestRun::new(programs!());
        let settings = settings(method, "navigation");
        let mut all: Vec<&str> = settings.iter().map(String::as_str).collect();
        all.push("resources.actors=3");
        let mut training = run.train(&all);
        for (checkpoint, process) in [(8, "learner"), (12, "actor-1")] {
            training.await_checkpoint(checkpoint);
            run.process(process).signal(Signal::Kill);
        }
        let disturbed = training.finish();
        assert_eq!(disturbed.iterations, ITERATIONS);
        assert_eq!(disturbed.hashes(), undisturbed.hashes(), "{method}");
        assert!(run.remarks().contains("learner ended (signal: 9"), "{}", run.remarks());
    }
}

#[test]
fn every_learner_trains_again_from_its_log() {
    for method in ["gail", "bc", "bco", "sqil"] {
        let run = TestRun::new(programs!());
        let summary = train(&run, "navigation", method);
        let mut replay = run.program("goalward");
        replay.arg("replay").arg(run.folder().path()).arg("--retrain");
        let output = replay.output().unwrap();
        let said = String::from_utf8_lossy(&output.stdout);
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{method}: {said}{errors}");
        assert!(said.contains(&summary.hashes().policy), "{method}: {said}");
    }
}

#[test]
fn states_alone_are_refused_where_actions_are_needed() {
    let run = TestRun::new(programs!());
    let file = run.path("states.mcap");
    let recorded = train(&run, "navigation", "gaifo-s");
    assert!(recorded.episodes > 0);
    let demonstrations = run.folder().demonstrations_file();
    let task = run.folder().config().unwrap().task;
    let all = run::demonstrations::read(&demonstrations, &task, true).unwrap();
    let metadata = Metadata::new(Kind::Demonstrations, "navigation", 1);
    let mut writer = FileWriter::create(&file, &metadata, &[Topic::Trajectory]).unwrap();
    for (time, mut demonstration) in (0..).zip(all) {
        demonstration.discrete_actions.clear();
        writer.trajectory(&Encoded::encode(demonstration), time).unwrap();
    }
    writer.seal().unwrap();
    for (method, code) in [("gail", 2), ("bc", 2), ("sqil", 2), ("proximity-with-actions", 2)] {
        let folder = run.path(method);
        let mut goalward = run.program("goalward");
        goalward.args(["train", "--method", method, "--set", "demonstrations.episodes=10"]);
        goalward.arg("--demonstrations").arg(&file).arg("--run").arg(&folder);
        let output = goalward.output().unwrap();
        let errors = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{method}: {errors}");
        assert!(errors.contains("states.mcap") && errors.contains("states only"), "{errors}");
        assert_eq!(errors.lines().count(), 1, "{errors}");
        assert!(fs::metadata(&folder).is_err(), "a refusal leaves no trace");
    }
}
