//! Lines for people.

use std::io::Write;

/// Prints to standard output; nobody listening any more is no reason to end a run.
pub fn print_line(text: &str) {
    writeln!(std::io::stdout(), "{text}").ok();
}

/// Prints a remark for people to standard error.
pub fn print_remark(text: &str) {
    writeln!(std::io::stderr(), "goalward: {text}").ok();
}
