//! Keeps iceoryx2's own log lines, which dump whole structures, out of the user's terminal.
//!
//! Its errors become `tracing` errors without the dump of their origin, and its warnings debug lines. Anything below
//! that is not even formatted.

use std::fmt::Arguments;
use std::sync::Once;

use iceoryx2_log::{Log, LogLevel};

static QUIETEN: Once = Once::new();

struct Forwarder;

impl Log for Forwarder {
    fn log(&self, level: LogLevel, _origin: Arguments<'_>, message: Arguments<'_>) {
        match level {
            LogLevel::Error | LogLevel::Fatal => tracing::error!(target: "iceoryx2", "{message}"),
            _ => tracing::debug!(target: "iceoryx2", "{message}"),
        }
    }
}

/// Redirects iceoryx2's log. Must be called before iceoryx2 logs anything; later calls do nothing.
pub(super) fn quieten() {
    QUIETEN.call_once(|| {
        iceoryx2_log::set_logger(&Forwarder);
        iceoryx2_log::set_log_level(LogLevel::Warn);
    });
}
