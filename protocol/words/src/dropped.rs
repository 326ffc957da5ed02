//! Messages that a process drops because it cannot use them.
//!
//! They are counted, and logged at most once a second, so that a sender can neither end the process nor fill the disk
//! with log lines.

use std::fmt::Display;
use std::time::{Duration, Instant};

/// Minimum time between two log lines.
const QUIET: Duration = Duration::from_secs(1);

/// Maximum length of a reason in a log line, in characters. Parts of it may be the sender's text.
const REASON_CHARS: usize = 300;

/// The count of dropped messages of one kind.
#[derive(Clone, Debug)]
pub struct Dropped {
    what: &'static str,
    count: u64,
    told: Option<Instant>,
}

impl Dropped {
    /// Starts at a count of 0. `what` names the messages.
    pub fn new(what: &'static str) -> Dropped {
        Dropped { what, count: 0, told: None }
    }

    /// Counts a message that cannot be used, and warns if a line is due.
    pub fn note(&mut self, why: impl Display) {
        if let Some(line) = self.line(why, Instant::now()) {
            tracing::warn!("{line}");
        }
    }

    /// Counts a message that violates an invariant, and logs an error if a line is due.
    pub fn note_loudly(&mut self, why: impl Display) {
        if let Some(line) = self.line(why, Instant::now()) {
            tracing::error!("{line}");
        }
    }

    /// Counts a message and returns the line to log, if one is due.
    fn line(&mut self, why: impl Display, now: Instant) -> Option<String> {
        self.count += 1;
        if self.told.is_some_and(|told| now.duration_since(told) < QUIET) {
            return None;
        }
        self.told = Some(now);
        let why = shortened(&why.to_string(), REASON_CHARS);
        Some(format!("{} dropped so far: {}; the newest: {why}", self.what, self.count))
    }
}

/// Makes foreign text fit for a line: replaces control characters and cuts it after `most` characters.
pub fn shortened(text: &str, most: usize) -> String {
    let clean = |letter: char| if letter.is_control() { '\u{fffd}' } else { letter };
    let mut short: String = text.chars().take(most).map(clean).collect();
    if text.chars().nth(most).is_some() {
        short.push_str("...");
    }
    short
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flood_is_counted_and_told_once_a_second() {
        let start = Instant::now();
        let mut dropped = Dropped::new("leases");
        let first = dropped.line("no lane 7", start).unwrap();
        assert_eq!(first, "leases dropped so far: 1; the newest: no lane 7");
        for _ in 0..1_000 {
            assert_eq!(dropped.line("again", start + QUIET / 2), None);
        }
        let second = dropped.line("again", start + QUIET).unwrap();
        assert_eq!(second, "leases dropped so far: 1002; the newest: again");
    }

    #[test]
    fn a_reason_is_one_short_line() {
        let line = Dropped::new("words").line("a\nb".repeat(10_000), Instant::now()).unwrap();
        assert!(line.len() < 2_000 && !line.contains('\n'), "{line}");
    }
}
