//! The line on standard error that shows the progress of long work: on a terminal it updates itself, in a pipe it is
//! printed now and then.

use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::print::print_remark;
use crate::voice;

/// Time between two lines in a pipe.
const LINE_EVERY: Duration = Duration::from_secs(10);

/// The same if the line has not changed.
const SAME_LINE_EVERY: Duration = Duration::from_secs(60);

/// A status line, and remarks above it.
pub enum StatusLine {
    /// The line stays at the bottom of the terminal.
    Terminal(ProgressBar),
    /// The line is printed again when it is due.
    Pipe(Printed),
    /// The user does not want to see the line.
    Quiet,
}

/// What has been printed to a pipe.
#[derive(Default)]
pub struct Printed {
    last: Option<(Instant, String)>,
    /// Tenths of the work that were done by then.
    tenth: u64,
}

impl Printed {
    /// Returns whether a line is to be printed, and if so notes it as printed.
    fn is_due(&mut self, now: Instant, tenth: u64, is_news: bool, line: &str) -> bool {
        let is_due = self.last.as_ref().is_none_or(|(at, last)| {
            let every = if last == line { SAME_LINE_EVERY } else { LINE_EVERY };
            now.duration_since(*at) >= every || (last != line && is_news)
        });
        if !is_due && tenth <= self.tenth {
            return false;
        }
        self.tenth = self.tenth.max(tenth);
        self.last = Some((now, line.to_owned()));
        true
    }
}

impl Default for StatusLine {
    fn default() -> Self {
        StatusLine::new()
    }
}

impl StatusLine {
    /// Creates a line for a terminal if standard error is one that can redraw a line, which one called `dumb` cannot;
    /// for a pipe otherwise.
    pub fn new() -> Self {
        let target = ProgressDrawTarget::stderr();
        if voice::is_quiet() {
            return StatusLine::Quiet;
        }
        if target.is_hidden() {
            return StatusLine::Pipe(Printed::default());
        }
        let bar = ProgressBar::with_draw_target(None, target);
        bar.set_style(
            ProgressStyle::with_template("{spinner} {wide_msg}")
                .expect("the template is well formed"),
        );
        StatusLine::Terminal(bar)
    }

    /// Makes the line wait until it is due for the first time, so that nothing is printed to a pipe for work that takes
    /// only a moment.
    pub fn patient(mut self) -> Self {
        if let StatusLine::Pipe(printed) = &mut self {
            printed.last = Some((Instant::now(), String::new()));
        }
        self
    }

    /// Shows at once what is going on.
    pub fn say(&self, text: &str) {
        match self {
            StatusLine::Terminal(bar) => bar.set_message(text.to_owned()),
            StatusLine::Pipe(_) => print_remark(text),
            StatusLine::Quiet => {}
        }
    }

    /// Shows the newest line; in a pipe only if it is due: after some time, with each tenth of the work, and when there
    /// is news.
    pub fn show(&mut self, line: &str, tenth: u64, is_news: bool) {
        match self {
            StatusLine::Terminal(bar) => {
                bar.set_message(line.to_owned());
                bar.tick();
            }
            StatusLine::Pipe(printed) => {
                if printed.is_due(Instant::now(), tenth, is_news, line) {
                    print_remark(line);
                }
            }
            StatusLine::Quiet => {}
        }
    }

    /// Animates the line on a terminal.
    pub fn tick(&self) {
        if let StatusLine::Terminal(bar) = self {
            bar.tick();
        }
    }

    /// Prints a remark above the line.
    pub fn note(&self, text: &str) {
        let print = || print_remark(text);
        match self {
            StatusLine::Terminal(bar) => bar.suspend(print),
            StatusLine::Pipe(_) | StatusLine::Quiet => print(),
        };
    }

    /// Removes the line from the terminal.
    pub fn finish(&self) {
        if let StatusLine::Terminal(bar) = self {
            bar.finish_and_clear();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pipe_gets_a_line_now_and_then() {
        let start = Instant::now();
        let mut printed = Printed::default();
        let mut is_due = |second, tenth, line| {
            printed.is_due(start + Duration::from_secs(second), tenth, false, line)
        };
        assert!(is_due(0, 0, "a"));
        assert!(!is_due(9, 0, "b"));
        assert!(is_due(10, 0, "b"));
        assert!(is_due(11, 1, "c"), "a tenth is done");
        assert!(!is_due(12, 0, "d"), "going back is no news");
        assert!(!is_due(30, 1, "c"), "nothing new");
        assert!(is_due(71, 1, "c"));
    }

    #[test]
    fn a_patient_line_says_nothing_of_a_moment() {
        let line = StatusLine::Pipe(Printed::default());
        let StatusLine::Pipe(mut printed) = line.patient() else { unreachable!() };
        let now = Instant::now();
        assert!(!printed.is_due(now, 0, false, "a"));
        assert!(printed.is_due(now + LINE_EVERY, 0, false, "b"));
    }
}
