//! The signals a supervisor lives by.

use anyhow::{Context, Result};
use tokio::signal::unix::{Signal, SignalKind, signal};

/// All of them. Each half can be waited for on its own; what comes meanwhile is kept.
pub(super) struct Signals {
    /// Wishes of the user that the run stop.
    pub(super) stop: StopSignals,
    /// Deaths of children; one signal may stand for several.
    pub(super) child: ChildSignals,
}

/// Ctrl-C, a polite kill, the end of the terminal.
pub(super) struct StopSignals {
    interrupt: Signal,
    terminate: Signal,
    hangup: Signal,
}

/// See [`Signals::child`].
pub(super) struct ChildSignals(Signal);

impl Signals {
    /// Takes the signals over from here on.
    pub(super) fn listen() -> Result<Self> {
        let listen = |kind| signal(kind).context("listening for signals");
        Ok(Signals {
            stop: StopSignals {
                interrupt: listen(SignalKind::interrupt())?,
                terminate: listen(SignalKind::terminate())?,
                hangup: listen(SignalKind::hangup())?,
            },
            child: ChildSignals(listen(SignalKind::child())?),
        })
    }
}

impl StopSignals {
    /// Returns when the user wants the run to stop.
    pub(super) async fn next(&mut self) {
        tokio::select! {
            _ = self.interrupt.recv() => {}
            _ = self.terminate.recv() => {}
            _ = self.hangup.recv() => {}
        }
    }
}

impl ChildSignals {
    /// Returns when a child may have died.
    pub(super) async fn next(&mut self) {
        self.0.recv().await;
    }
}
