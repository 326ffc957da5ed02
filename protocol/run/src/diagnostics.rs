//! Diagnostics of programs on standard error, in one of two forms: for people, lines that begin with
//! `goalward:`, whichever program they come from, and for a log file, lines with time and level.

use std::fmt;
use std::io::IsTerminal;

use tracing::{Event, Level, Subscriber};
use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt::format::Writer;
use tracing_subscriber::fmt::{FmtContext, FormatEvent, FormatFields};
use tracing_subscriber::registry::LookupSpan;

/// A form of diagnostics.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Diagnostics {
    /// `goalward: message`.
    ForPeople,
    /// `2026-01-31T12:00:00.000000Z ERROR learner: message`.
    ForLog,
}

impl Diagnostics {
    /// Returns the form for a long-running process: people read it only if the process was started
    /// by hand, on a terminal.
    pub fn of_service() -> Diagnostics {
        match std::io::stderr().is_terminal() {
            true => Diagnostics::ForPeople,
            false => Diagnostics::ForLog,
        }
    }

    /// Starts to print messages of `level`, such as `info`, and above; `RUST_LOG` overrides it.
    pub fn begin(self, level: &str) {
        let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(level));
        let lines = tracing_subscriber::fmt()
            .with_env_filter(filter)
            .with_writer(std::io::stderr)
            .with_ansi(false)
            // Otherwise a line that the disk does not take would make the process panic.
            .log_internal_errors(false);
        match self {
            Diagnostics::ForPeople => lines.event_format(PlainLine).init(),
            Diagnostics::ForLog => lines.init(),
        }
    }
}

/// Formats a line for people.
struct PlainLine;

impl<S, N> FormatEvent<S, N> for PlainLine
where
    S: Subscriber + for<'a> LookupSpan<'a>,
    N: for<'a> FormatFields<'a> + 'static,
{
    fn format_event(
        &self,
        context: &FmtContext<'_, S, N>,
        mut writer: Writer<'_>,
        event: &Event<'_>,
    ) -> fmt::Result {
        let metadata = event.metadata();
        write!(writer, "goalward: ")?;
        match *metadata.level() {
            Level::ERROR | Level::INFO => {}
            Level::WARN => write!(writer, "warning: ")?,
            Level::DEBUG | Level::TRACE => write!(writer, "{}: ", metadata.target())?,
        }
        context.format_fields(writer.by_ref(), event)?;
        writeln!(writer)
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;
    use std::sync::{Arc, Mutex};

    use super::*;

    #[derive(Clone, Default)]
    struct Shown(Arc<Mutex<Vec<u8>>>);

    impl Write for Shown {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.0.lock().unwrap().write(bytes)
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn lines_for_people_have_one_form() {
        let shown = Shown::default();
        let writer = shown.clone();
        let lines = tracing_subscriber::fmt().with_ansi(false).event_format(PlainLine);
        let lines = lines.with_writer(move || writer.clone()).finish();
        tracing::subscriber::with_default(lines, || {
            tracing::error!("the disk is gone");
            tracing::warn!("2 leases are open again");
            tracing::info!("joined");
        });
        let shown = String::from_utf8(shown.0.lock().unwrap().clone()).unwrap();
        let expected = "goalward: the disk is gone\n\
                        goalward: warning: 2 leases are open again\n\
                        goalward: joined\n";
        assert_eq!(shown, expected);
    }
}
