//! The signals that whoever watches over processes lives by.

use anyhow::{Context, Result};
use tokio::signal::unix::{Signal, SignalKind, signal};

/// All of them. Each half can be waited for on its own; what comes meanwhile is kept.
pub(crate) struct Signals {
    /// Wishes of the user that the run stop.
    pub(crate) stop: StopSignals,
    /// Deaths of children; one signal may stand for several.
    pub(crate) child: ChildSignals,
}

/// Ctrl-C, a polite kill, the end of the terminal.
pub(crate) struct StopSignals {
    interrupt: Signal,
    terminate: Signal,
    hangup: Signal,
}

/// See [`Signals::child`].
pub(crate) struct ChildSignals(Signal);

impl Signals {
    /// Takes the signals over from here on.
    pub(crate) fn listen() -> Result<Self> {
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
    pub(crate) async fn next(&mut self) {
        tokio::select! {
            _ = self.interrupt.recv() => {}
            _ = self.terminate.recv() => {}
            _ = self.hangup.recv() => {}
        }
    }
}

impl ChildSignals {
    /// Returns when a child may have died.
    pub(crate) async fn next(&mut self) {
        self.0.recv().await;
    }
}
