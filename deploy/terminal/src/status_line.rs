//! The line that says on standard error how something long stands: on a terminal it updates itself, into a
//! pipe it is printed now and then.

use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::print::print_remark;
use crate::voice;

/// Time between two lines in a pipe.
const LINE_EVERY: Duration = Duration::from_secs(10);

/// The same if there is nothing new to say.
const SAME_LINE_EVERY: Duration = Duration::from_secs(60);

/// A line, and remarks.
pub enum StatusLine {
    /// It stays at the bottom.
    Terminal(ProgressBar),
    /// It comes again when it is due.
    Pipe(Printed),
    /// Nobody wants to see it.
    Quiet,
}

/// What has been printed to a pipe.
#[derive(Default)]
pub struct Printed {
    last: Option<(Instant, String)>,
    /// Tenths that were done by then.
    tenth: u64,
}

impl Printed {
    /// Whether a line is to be printed; it is noted as printed then.
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
    /// For a terminal if standard error is one that can redraw a line, which one called `dumb` cannot; for
    /// a pipe otherwise.
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

    /// The same line for what may be done in a moment: nothing of that is printed to a pipe.
    pub fn patient(mut self) -> Self {
        if let StatusLine::Pipe(printed) = &mut self {
            printed.last = Some((Instant::now(), String::new()));
        }
        self
    }

    /// Says at once what is going on.
    pub fn say(&self, text: &str) {
        match self {
            StatusLine::Terminal(bar) => bar.set_message(text.to_owned()),
            StatusLine::Pipe(_) => print_remark(text),
            StatusLine::Quiet => {}
        }
    }

    /// Shows the newest line; in a pipe only if it is due: after some time, with each tenth of the
    /// whole, and when it has news.
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

    /// Keeps the line alive.
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
