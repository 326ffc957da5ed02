//! What all processes of a run have in common: their output, how they stop, their exit code.
//!
//! `goalward` holds a pipe to the standard input of each process that it starts, and says so in
//! [`INPUT_IS_HELD`]. It closes the pipe to stop the process; the pipe also closes when `goalward` is
//! gone. Either way, the process stops. Any other input (a terminal, `/dev/null`, the closed pipe of a
//! remote shell) means nothing: a process started by hand runs until a signal ends it or its work is done.

use std::error::Error;
use std::fmt::Display;
use std::io::Read;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use crate::diagnostics::Diagnostics;

/// Environment variable that tells a process to stop when its standard input ends.
pub const INPUT_IS_HELD: &str = "GOALWARD_INPUT_IS_HELD";

/// How often a sleeping thread checks whether the process should stop.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// Whether the process has been asked to stop. Cheap to check and to clone.
#[derive(Clone, Debug, Default)]
pub struct Stop {
    requested: Arc<AtomicBool>,
    is_held: bool,
}

impl Stop {
    /// Returns whether the process has been asked to stop.
    pub fn is_requested(&self) -> bool {
        self.requested.load(Ordering::Relaxed)
    }

    /// Asks the process to stop.
    pub fn request(&self) {
        self.requested.store(true, Ordering::Relaxed);
    }

    /// Returns whether a parent holds this process's standard input, so that the process stops with its parent.
    pub fn is_held(&self) -> bool {
        self.is_held
    }

    /// Sleeps for `duration`, or until the process is asked to stop; returns whether it was.
    pub fn sleep(&self, duration: Duration) -> bool {
        let deadline = Instant::now() + duration;
        while !self.is_requested() {
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return false;
            }
            std::thread::sleep(left.min(LOOK_EVERY));
        }
        true
    }

    /// Returns a [`Stop`] that asks the process to stop when its standard input ends, if its parent holds that.
    ///
    /// # Errors
    /// If the thread that watches the input cannot start.
    pub fn at_end_of_input() -> std::io::Result<Stop> {
        let stop = Stop { is_held: is_held(), ..Stop::default() };
        if stop.is_held {
            let requested = stop.clone();
            at_end_of_input(move || requested.request())?;
        }
        Ok(stop)
    }
}

/// Ends the process when its parent is gone, for work that nobody else waits for.
///
/// # Errors
/// If the thread that watches the standard input cannot start.
pub fn end_with_parent() -> std::io::Result<()> {
    if is_held() {
        at_end_of_input(|| std::process::exit(1))?;
    }
    Ok(())
}

/// Calls `then` on a thread of its own when the standard input ends.
///
/// # Errors
/// If the thread cannot start.
pub fn at_end_of_input(then: impl FnOnce() + Send + 'static) -> std::io::Result<()> {
    let watch = move || {
        let mut ignored = [0; 64];
        while !matches!(std::io::stdin().read(&mut ignored), Ok(0) | Err(_)) {}
        then();
    };
    std::thread::Builder::new().name("end-of-input".to_owned()).spawn(watch).map(drop)
}

fn is_held() -> bool {
    std::env::var_os(INPUT_IS_HELD).is_some()
}

/// Exit code of a process that failed with [`Final`].
pub const FINAL_CODE: u8 = 4;

/// A failure that would recur if the process were started again: training that diverged, or
/// demonstrations that are not the run's.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct Final(pub String);

/// Runs a process to its end, with diagnostics on standard error and one line for a failure.
/// Returns exit code 0, 1 or [`FINAL_CODE`].
pub fn run<E>(diagnostics: Diagnostics, body: impl FnOnce() -> Result<(), E>) -> ExitCode
where
    E: Display + AsRef<dyn Error + 'static>,
{
    diagnostics.begin("info");
    match body() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            tracing::error!("{error:#}");
            if is_final(error.as_ref()) { FINAL_CODE.into() } else { ExitCode::FAILURE }
        }
    }
}

/// Returns whether an error is or was caused by a [`Final`].
fn is_final(error: &(dyn Error + 'static)) -> bool {
    let mut causes = std::iter::successors(Some(error), |&cause| cause.source());
    causes.any(|cause| cause.is::<Final>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sleeper_is_woken_by_a_stop() {
        let stop = Stop::default();
        assert!(!stop.sleep(Duration::from_millis(1)));
        let begun = Instant::now();
        std::thread::scope(|scope| {
            scope.spawn(|| stop.request());
            assert!(stop.sleep(Duration::from_secs(60)));
        });
        assert!(begun.elapsed() < Duration::from_secs(30));
    }
}
