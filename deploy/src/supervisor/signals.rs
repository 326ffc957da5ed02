//! The signals that supervision reacts to.

use anyhow::{Context, Result};
use tokio::signal::unix::{Signal, SignalKind, signal};

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
    hangup: Signal,
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
