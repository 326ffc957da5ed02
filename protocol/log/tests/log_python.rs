//! The log is read by the public Python packages for MCAP and protobuf, with no help from us.
//!
//! Needs the packages of `tests/requirements.txt` for the interpreter in `GOALWARD_PYTHON`; `GOALWARD_PYTHON=none`
//! skips the test.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::path::Path;
use std::process::Command;

use bytes::Bytes;
use mcap_log::{Kind, LogOptions, LogWriter, Metadata};
use protocol::messages::{Checkpoint, PolicyUpdate, RewardUpdate, Score};
use protocol::trajectory::{Encoded, Source, Trajectory, TrajectoryKey};

fn packed(numbers: &[f32]) -> Bytes {
    numbers.iter().flat_map(|number| number.to_le_bytes()).collect()
}

fn write_log(folder: &Path) {
    let metadata = Metadata::new(Kind::Run, "navigation", 7).with("config", "lag = 0\n");
    let mut writer = LogWriter::create(folder, &metadata, LogOptions::default()).unwrap();
    for (episode, source) in [(0, Source::Training), (1, Source::Evaluation)] {
        let trajectory = Trajectory {
            task: "navigation".to_owned(),
            source: source as i32,
            lane: 3,
            episode,
            observation_shape: vec![19, 19],
            cells: Bytes::from_static(&[0, 1, 2]),
            log_probs: packed(&[-0.5, -1.25]),
            state_hash: u64::MAX,
            ..Trajectory::default()
        };
        writer.trajectory(&Encoded::encode(trajectory)).unwrap();
    }
    let score = Score { lane: 3, rewards: vec![0.5, -0.25], ..Score::default() };
    writer.score(&score).unwrap();
    let consumed = vec![TrajectoryKey { lane: 3, episode: 1, hash: 9 }];
    let update = PolicyUpdate { consumed, entropy: 1.5, ..PolicyUpdate::default() };
    writer.policy_update(&update).unwrap();
    writer.reward_update(&RewardUpdate { agent_loss: 0.25, ..RewardUpdate::default() }).unwrap();
    let path = "checkpoints/1".to_owned();
    writer.checkpoint(&Checkpoint { path, ..Checkpoint::default() }).unwrap();
    writer.finish().unwrap();
}

fn read_with_python(python: &str, file: &Path) -> Vec<String> {
    let tests = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests");
    let output = Command::new(python).arg(tests.join("log_python.py")).arg(file).output();
    let output =
        output.unwrap_or_else(|cause| panic!("GOALWARD_PYTHON: cannot run {python}: {cause}"));
    assert!(
        output.status.success(),
        "{python} does not read {}; it needs `pip install -r tests/requirements.txt`, and \
         GOALWARD_PYTHON can name another interpreter:\n{}",
        file.display(),
        String::from_utf8_lossy(&output.stderr),
    );
    let lines = String::from_utf8(output.stdout).unwrap();
    lines.lines().map(str::to_owned).collect()
}

fn assert_line(line: &str, parts: &[&str]) {
    for part in parts {
        assert!(line.contains(part), "expected {part} in {line}");
    }
}

#[test]
fn python_reads_the_log() {
    let named = std::env::var("GOALWARD_PYTHON").ok().filter(|python| !python.is_empty());
    let python =
        named.expect("GOALWARD_PYTHON: expected an interpreter, or `none`; deploy/test.sh sets it");
    if python == "none" {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    write_log(folder.path());

    let lines = read_with_python(&python, &folder.path().join("trajectories-00000.mcap"));
    assert_eq!(lines.len(), 4, "{lines:?}");
    assert_line(&lines[0], &[r#""metadata": "goalward.run""#, r#""seed": "7""#, r#""lag = 0\n""#]);
    for (line, topic, more) in [
        (&lines[1], "/trajectory", r#""lane": "3""#),
        (&lines[2], "/evaluation/trajectory", r#""source": "EVALUATION""#),
    ] {
        let topic = format!(r#""topic": "{topic}""#);
        let schema = r#""schema": "goalward.v1.Trajectory""#;
        let arrays = [r#""log_probs": [-0.5, -1.25]"#, r#""observation_shape": [19, 19]"#];
        assert_line(line, &[&topic, more, schema, arrays[0], arrays[1]]);
        assert_line(line, &[r#""cells": "AAEC""#, r#""state_hash": "18446744073709551615""#]);
    }
    assert_line(
        &lines[3],
        &["goalward.v1.Score", r#""rewards": [0.5, -0.25]"#, r#""sequence": 0"#],
    );

    let lines = read_with_python(&python, &folder.path().join("updates-00000.mcap"));
    assert_eq!(lines.len(), 4, "{lines:?}");
    assert_line(&lines[1], &["/policy/update", r#""hash": "9""#, r#""entropy": 1.5"#]);
    assert_line(&lines[2], &["/proximity/update", r#""agent_loss": 0.25"#]);
    assert_line(&lines[3], &["/checkpoint", r#""path": "checkpoints/1""#]);
}
