//! Exported policies and reward models reproduce in onnxruntime what actors and the service recorded.
//!
//! Method: small runs of the real programs; `exported.py` finds the exported version in the log by the hash of its
//! weights and compares. The test needs the packages of `tests/requirements.txt`; `GOALWARD_PYTHON=none` skips it.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::process::Command;

use serde_json::Value;
use system_tests::{TestRun, programs, python};

/// Largest difference allowed for single precision.
const LARGEST: f64 = 1e-5;

/// The checkpoint that is exported. Its policy acts and its reward model scores in the iterations after it.
const CHECKPOINT: &str = "4";

/// Tasks and methods whose networks differ in kind, with their settings.
const METHODS: [(&str, &str, &[&str]); 9] = [
    ("navigation", "goal-proximity", &["reward.batch=32"]),
    ("navigation", "goal-proximity", &["reward.batch=32", "policy.shared_trunk=false"]),
    ("navigation", "gaifo", &["reward.batch=32"]),
    ("navigation", "proximity-with-actions", &["reward.batch=32"]),
    ("fetch-push", "goal-proximity", &["reward.prior=2.0"]),
    ("fetch-push", "ranking", &[]),
    ("fetch-push", "temporal-distance", &[]),
    ("fetch-push", "gail", &[]),
    (
        "fetch-push",
        "sqil",
        &[
            "sqil.batch=8",
            "sqil.updates_per_step=0.05",
            "sqil.exploration_steps=800",
            "sqil.hidden=[16, 16]",
        ],
    ),
];

fn train(task: &str, method: &str, settings: &[&str]) -> TestRun {
    let run = TestRun::new(programs!());
    let name = format!("method={method}");
    let settings = [settings, &[name.as_str(), "steps=2400"]].concat();
    run.train_task(task, &settings).finish();
    run
}

fn compared(python: &str, run: &TestRun, squashed: bool) -> Value {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/exported.py");
    let mut command = Command::new(python);
    command.arg(script).arg(run.folder().path()).arg(run.path("export"));
    let output = command.arg(if squashed { "squashed" } else { "" }).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn exported_models_say_what_was_recorded() {
    let Some(python) = python() else { return };
    for (task, method, settings) in METHODS {
        let run = train(task, method, settings);
        let (folder, out) = (run.folder(), run.path("export"));
        let (folder, out) = (folder.path().to_str().unwrap(), out.to_str().unwrap());
        let arguments = ["export", folder, "--out", out, "--checkpoint", CHECKPOINT];
        let (well, said) = run.goalward(&arguments);
        assert!(well, "{task} {method}: {said}");
        let found = compared(&python, &run, method == "sqil");
        let context = format!("{task} {method} {settings:?}: {found}");
        assert!(found["policy"]["steps"].as_u64().unwrap() > 100, "{context}");
        assert!(found["policy"]["difference"].as_f64().unwrap() < LARGEST, "{context}");
        let ensemble = &found["ensemble"];
        assert_eq!(ensemble.is_null(), method == "sqil", "{context}");
        if !ensemble.is_null() {
            assert!(ensemble["rows"].as_u64().unwrap() > 100, "{context}");
            assert!(ensemble["proximity"].as_f64().unwrap() < LARGEST, "{context}");
            assert!(ensemble["uncertainty"].as_f64().unwrap() < LARGEST, "{context}");
        }
    }
}
