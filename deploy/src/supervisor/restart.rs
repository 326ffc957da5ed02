//! Decides when a dead process is restarted, when it is left alone for a while, and when the run is given up.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// Deaths of one actor within [`DEATH_WINDOW`] after which it is left alone for a while.
pub(super) const MOST_DEATHS: usize = 5;

/// See [`MOST_DEATHS`].
pub(super) const DEATH_WINDOW: Duration = Duration::from_secs(30);

/// Longest time that an actor is left alone.
const LONGEST_REST: Duration = Duration::from_secs(600);

/// Most restarts of learner and proximity service without a new checkpoint in between.
pub(super) const MOST_RESTARTS: u32 = 3;

/// The recent deaths of one process, and how often it was left alone because of them.
#[derive(Debug, Default)]
pub(super) struct Deaths {
    recent: VecDeque<Instant>,
    rests: u32,
}

impl Deaths {
    /// Notes a death. Returns how long to leave the process alone if it has died too often, longer every time; `None`
    /// if it has not.
    pub(super) fn note(&mut self, now: Instant) -> Option<Duration> {
        self.recent.push_back(now);
        while self.recent.front().is_some_and(|&death| now.duration_since(death) > DEATH_WINDOW) {
            self.recent.pop_front();
        }
        if self.recent.len() < MOST_DEATHS {
            return None;
        }
        self.recent.clear();
        let rest = DEATH_WINDOW.saturating_mul(1 << self.rests.min(16)).min(LONGEST_REST);
        self.rests += 1;
        Some(rest)
    }
}

/// The number of restarts of learner and proximity service since the newest checkpoint.
#[derive(Debug, Default)]
pub(super) struct CoreRestarts {
    checkpoint: Option<u64>,
    count: u32,
}

impl CoreRestarts {
    /// Notes a death, with the iteration of the newest checkpoint; returns whether both processes are to be restarted.
    pub(super) fn allow_restart(&mut self, newest_checkpoint: Option<u64>) -> bool {
        if newest_checkpoint != self.checkpoint {
            *self = CoreRestarts { checkpoint: newest_checkpoint, count: 0 };
        }
        self.count += 1;
        self.count <= MOST_RESTARTS
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn five_deaths_in_half_a_minute_are_too_many() {
        let start = Instant::now();
        let at = |seconds| start + Duration::from_secs(seconds);
        let mut deaths = Deaths::default();
        let answers = [0, 10, 20, 29, 31, 32].map(|second| deaths.note(at(second)));
        // At 31 s the first death is forgotten; at 32 s there are five again.
        let rest = Some(Duration::from_secs(30));
        assert_eq!(answers, [None, None, None, None, None, rest]);
        let answers = [62, 62, 62, 62, 63].map(|second| deaths.note(at(second)));
        assert_eq!(answers, [None, None, None, None, Some(Duration::from_secs(60))]);
        let last = (0..100).filter_map(|_| deaths.note(at(200))).last();
        assert_eq!(last, Some(LONGEST_REST));
    }

    #[test]
    fn a_new_checkpoint_makes_restarts_count_anew() {
        let mut restarts = CoreRestarts::default();
        let answers = [None, None, None, Some(25), Some(25), Some(25), Some(25)]
            .map(|newest| restarts.allow_restart(newest));
        assert_eq!(answers, [true, true, true, true, true, true, false]);
    }
}
