//! Lines for people: results on standard output, everything else on standard error.

use std::io::Write;

use anstyle::{AnsiColor, Style};

use crate::voice;

const ERROR: Style = AnsiColor::Red.on_default().bold();
const REMARK: Style = Style::new().bold();

/// Prints a result to standard output; nobody listening any more is no reason to end a run.
pub fn print_line(text: &str) {
    writeln!(anstream::stdout(), "{text}").ok();
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
