//! The metadata of files that have to do with a task.

use std::collections::BTreeMap;

use mcap_log::{Kind, Metadata};
use protocol::task::Task;

use crate::config::RunConfig;

/// What the metadata of a file calls the shapes of its task.
const SPEC: &str = "spec";

/// Metadata of a file that has to do with a task, whose shapes it carries.
pub fn of_task(kind: Kind, task: &Task, seed: u64) -> Metadata {
    let spec = serde_json::to_string(task).expect("a task has only plain values");
    Metadata::new(kind, &task.name, seed).with(SPEC, spec)
}

/// Metadata of a run's log, which carries its whole configuration.
pub fn of_run(config: &RunConfig) -> Metadata {
    of_task(Kind::Run, &config.task, config.seed).with("config", config.to_text())
}

/// What an exported network of a run says of itself: what the run's log says, after how many iterations
/// the network was saved, and the hash of its weights.
pub fn of_export(config: &RunConfig, iteration: u64, sha256: &str) -> BTreeMap<String, String> {
    of_run(config).with("iteration", iteration).with("weights_sha256", sha256).entries
}

/// The task that a file was recorded in; none in a file that does not tell more than its name.
pub fn recorded_task(metadata: &Metadata) -> Option<Task> {
    serde_json::from_str(metadata.get(SPEC)?).ok()
}
