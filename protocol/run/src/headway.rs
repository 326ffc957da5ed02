//! How far a program is that was started for one piece of work, such as an evaluation. It says so in
//! lines of JSON on its standard output, before the result it ends with; whoever started it shows them.

use std::io::Write;
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

/// Time between two lines.
const EVERY: Duration = Duration::from_millis(200);

/// How far a piece of work is.
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

/// Says how far this process is.
#[derive(Debug, Default)]
pub struct Teller {
    told: Option<Instant>,
}

impl Teller {
    /// Says it, unless it was said a moment ago. That nobody listens is no failure.
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
