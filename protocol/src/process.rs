//! The shell every process of a run wears: its output, its end, its exit code.
//!
//! The supervisor holds a pipe to each process's standard input. When the pipe closes, because the
//! supervisor wants the process to stop or because the supervisor is gone, the process stops.

use std::fmt::Display;
use std::io::{IsTerminal, Read};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Whether the process has been asked to stop. Cheap to ask, cheap to share.
#[derive(Clone, Debug, Default)]
pub struct Stop(Arc<AtomicBool>);

impl Stop {
    /// Whether the process is to stop.
    pub fn is_requested(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    /// Asks it to stop.
    pub fn request(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Asks the process to stop when its standard input ends.
    pub fn at_end_of_input() -> Stop {
        let stop = Stop::default();
        let requested = stop.clone();
        let watch = move || {
            let mut ignored = [0; 64];
            while !matches!(std::io::stdin().read(&mut ignored), Ok(0) | Err(_)) {}
            requested.request();
        };
        std::thread::Builder::new()
            .name("end-of-input".to_owned())
            .spawn(watch)
            .expect("a process can start one more thread");
        stop
    }
}

/// Runs a process to its end: diagnostics on standard error, one line for a failure, exit code 0 or
/// 1.
pub fn run<E: Display>(body: impl FnOnce() -> Result<(), E>) -> ExitCode {
    let filter = tracing_subscriber::EnvFilter::try_from_default_env()
        .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new("info"));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        // Otherwise a disk that does not take the line would end the process in a panic.
        .log_internal_errors(false)
        .with_ansi(std::io::stderr().is_terminal())
        .init();
    match body() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            tracing::error!("{error:#}");
            ExitCode::FAILURE
        }
    }
}
