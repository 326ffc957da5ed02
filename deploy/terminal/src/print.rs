//! Lines for people: results on standard output, everything else on standard error.

use std::io::{ErrorKind, Write};
use std::sync::atomic::{AtomicBool, Ordering};

use anstyle::{AnsiColor, Style};

use crate::voice;

const ERROR: Style = AnsiColor::Red.on_default().bold();
const REMARK: Style = Style::new().bold();

/// Whether a result could not be printed.
static IS_LOST: AtomicBool = AtomicBool::new(false);

/// Prints a result to standard output. If nobody reads it any more, that is no reason to end a run.
pub fn print_line(text: &str) {
    let mut output = anstream::stdout();
    let printed = writeln!(output, "{text}").and_then(|()| output.flush());
    if let Err(error) = printed
        && error.kind() != ErrorKind::BrokenPipe
    {
        print_error(&format!("standard output: {error}"));
        IS_LOST.store(true, Ordering::Relaxed);
    }
}

/// Returns whether all results were printed, apart from those that nobody read any more.
pub fn all_is_printed() -> bool {
    !IS_LOST.load(Ordering::Relaxed)
}

/// Prints a remark to standard error, unless only results and errors are wanted.
pub fn print_remark(text: &str) {
    if !voice::is_quiet() {
        print_to_error(REMARK, text);
    }
}

/// Prints an error to standard error.
pub fn print_error(text: &str) {
    print_to_error(ERROR, text);
}

fn print_to_error(style: Style, text: &str) {
    writeln!(anstream::stderr(), "{style}goalward:{style:#} {text}").ok();
}
