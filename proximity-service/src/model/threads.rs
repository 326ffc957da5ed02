//! The threads that a reward model computes on.

use anyhow::Result;
use rayon::{ThreadPool, ThreadPoolBuilder};
use run::config::RunConfig;

/// As many as a run gives its service.
pub(super) fn threads(config: &RunConfig) -> Result<ThreadPool> {
    Ok(ThreadPoolBuilder::new()
        .num_threads(config.resources.service_threads)
        .thread_name(|number| format!("ensemble-{number}"))
        .build()?)
}
