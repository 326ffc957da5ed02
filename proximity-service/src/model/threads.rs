//! Thread pool of a reward model.

use anyhow::Result;
use rayon::{ThreadPool, ThreadPoolBuilder};
use run::config::RunConfig;

/// Creates a pool with as many threads as the configuration gives the service.
pub(super) fn threads(config: &RunConfig) -> Result<ThreadPool> {
    Ok(ThreadPoolBuilder::new()
        .num_threads(config.resources.service_threads)
        .thread_name(|number| format!("ensemble-{number}"))
        .build()?)
}
