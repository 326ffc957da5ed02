//! When a process that died is started again, and when the run is given up instead.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// Deaths of one actor within [`DEATH_WINDOW`] that end the run.
pub(super) const MOST_DEATHS: usize = 5;

/// See [`MOST_DEATHS`].
pub(super) const DEATH_WINDOW: Duration = Duration::from_secs(30);

/// Restarts of learner and proximity service without a new checkpoint in between.
pub(super) const MOST_RESTARTS: u32 = 3;

/// When one actor died lately.
#[derive(Debug, Default)]
pub(super) struct ActorDeaths(VecDeque<Instant>);

impl ActorDeaths {
    /// Notes a death; returns whether the actor is to be started again.
    pub(super) fn allow_restart(&mut self, now: Instant) -> bool {
        self.0.push_back(now);
        while self.0.front().is_some_and(|&death| now.duration_since(death) > DEATH_WINDOW) {
            self.0.pop_front();
        }
        self.0.len() < MOST_DEATHS
    }
}

/// How often learner and proximity service were started again since the run last got further.
#[derive(Debug, Default)]
pub(super) struct CoreRestarts {
    checkpoint: Option<u64>,
    count: u32,
}

impl CoreRestarts {
    /// Notes a death, with the iteration of the newest checkpoint; returns whether both processes
    /// are to be started again.
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
        let mut deaths = ActorDeaths::default();
        let answers = [0, 10, 20, 29, 31, 32].map(|second| deaths.allow_restart(at(second)));
        // At 31 s the first death is forgotten; at 32 s there are five again.
        assert_eq!(answers, [true, true, true, true, true, false]);
    }

    #[test]
    fn a_new_checkpoint_makes_restarts_count_anew() {
        let mut restarts = CoreRestarts::default();
        let answers = [None, None, None, Some(25), Some(25), Some(25), Some(25)]
            .map(|newest| restarts.allow_restart(newest));
        assert_eq!(answers, [true, true, true, true, true, true, false]);
    }
}
