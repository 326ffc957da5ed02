//! The metadata of files that belong to a task.

use std::collections::BTreeMap;

use mcap_log::{Kind, Metadata};
use protocol::task::Task;

use crate::config::RunConfig;

/// Metadata key of a file's task with its shapes.
const SPEC: &str = "spec";

/// Returns the metadata of a file that belongs to a task, including the task's shapes.
pub fn of_task(kind: Kind, task: &Task, seed: u64) -> Metadata {
    let spec = serde_json::to_string(task).expect("a task has only plain values");
    Metadata::new(kind, &task.name, seed).with(SPEC, spec)
}

/// Returns the metadata of a run's log, including the whole configuration.
pub fn of_run(config: &RunConfig) -> Metadata {
    of_task(Kind::Run, &config.task, config.seed).with("config", config.to_text())
}

/// Returns the metadata of an exported network of a run: that of the run's log, the number of
/// iterations after which the network was saved, and the SHA-256 of its weights.
pub fn of_export(config: &RunConfig, iteration: u64, sha256: &str) -> BTreeMap<String, String> {
    of_run(config).with("iteration", iteration).with("weights_sha256", sha256).entries
}

/// Returns the task that a file was recorded in; `None` if the file has only the task's name.
pub fn recorded_task(metadata: &Metadata) -> Option<Task> {
    serde_json::from_str(metadata.get(SPEC)?).ok()
}
