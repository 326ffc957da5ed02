//! The progress of a program that was started for one piece of work, such as an evaluation. The program
//! prints it as lines of JSON on standard output, before its result; the program that started it shows them.

use std::io::Write;
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

/// Least time between two lines.
const EVERY: Duration = Duration::from_millis(200);

/// The progress of a piece of work.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Headway {
    /// Episodes done.
    pub episodes_done: u64,
    /// Episodes in all.
    pub episodes_wanted: u64,
    /// Environment steps done.
    pub steps_done: u64,
}

/// Prints the progress of this process.
#[derive(Debug, Default)]
pub struct Teller {
    told: Option<Instant>,
}

impl Teller {
    /// Prints the progress, unless it was printed a moment ago. It is no error if nobody reads it.
    pub fn tell(&mut self, headway: Headway) {
        if self.told.is_some_and(|told| told.elapsed() < EVERY) {
            return;
        }
        self.told = Some(Instant::now());
        if let Ok(line) = serde_json::to_string(&headway) {
            writeln!(std::io::stdout(), "{line}").ok();
        }
    }
}
