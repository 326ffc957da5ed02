//! The signals that supervision reacts to.

use std::fs;
use std::future;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use tokio::signal::unix::{Signal, SignalKind, signal};

/// A signal this soon after another belongs to the same request: `timeout` sends SIGTERM to its child and to the
/// child's group, and systemd ends a login session by SIGTERM with SIGHUP.
const SAME_REQUEST: Duration = Duration::from_millis(500);

/// All signals. Each field can be awaited on its own; a signal that arrives in the meantime is kept.
pub(crate) struct Signals {
    /// Requests of the user to stop the run.
    pub(crate) stop: StopSignals,
    /// Deaths of child processes; one signal may stand for several.
    pub(crate) child: ChildSignals,
}

/// Ctrl-C (SIGINT), SIGTERM, and the end of the terminal (SIGHUP).
pub(crate) struct StopSignals {
    interrupt: Signal,
    terminate: Signal,
    /// `None` if the process was started so that it ignores the end of the terminal, as by `nohup`.
    hangup: Option<Signal>,
    /// When the latest request arrived.
    requested: Option<Instant>,
}

/// See [`Signals::child`].
pub(crate) struct ChildSignals(Signal);

impl Signals {
    /// Begins to listen for the signals, which do not end the process from then on.
    pub(crate) fn listen() -> Result<Self> {
        let listen = |kind| signal(kind).context("listening for signals");
        Ok(Signals {
            stop: StopSignals {
                interrupt: listen(SignalKind::interrupt())?,
                terminate: listen(SignalKind::terminate())?,
                hangup: (!ignores_hangup()).then(|| listen(SignalKind::hangup())).transpose()?,
                requested: None,
            },
            child: ChildSignals(listen(SignalKind::child())?),
        })
    }
}

impl StopSignals {
    /// Returns when the user wants the run to stop, once for each request.
    pub(crate) async fn next(&mut self) {
        loop {
            tokio::select! {
                _ = self.interrupt.recv() => {}
                _ = self.terminate.recv() => {}
                () = received(self.hangup.as_mut()) => {}
            }
            if self.requested.is_none_or(|requested| requested.elapsed() > SAME_REQUEST) {
                self.requested = Some(Instant::now());
                return;
            }
        }
    }
}

/// Returns when a signal arrives: never, if there is none to listen for.
async fn received(signal: Option<&mut Signal>) {
    match signal {
        Some(signal) => drop(signal.recv().await),
        None => future::pending().await,
    }
}

/// Returns whether this process ignores SIGHUP, whose number is 1.
fn ignores_hangup() -> bool {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    mask.is_some_and(|mask| mask & 1 == 1)
}

impl ChildSignals {
    /// Returns when a child may have died.
    pub(crate) async fn next(&mut self) {
        self.0.recv().await;
    }
}
