//! What a run took until it succeeded, from the policy updates in its log.

use protocol::Error;
use protocol::messages::PolicyUpdate;
use serde::{Deserialize, Serialize};

use crate::folder::RunFolder;
use crate::updates::policy_updates;

/// The success rates for which times are taken.
pub const LEVELS: [f64; 4] = [0.5, 0.9, 0.95, 0.98];

/// What a run took until it reached a success rate for good.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TimeToSuccess {
    /// The success rate, in (0, 1].
    pub success_rate: f64,
    /// Environment steps; called `env_steps` in earlier summaries.
    #[serde(alias = "env_steps")]
    pub environment_steps: u64,
    /// Wall time of training, offline training included, seconds.
    pub wall_s: f64,
    /// Processor time of all processes in that time, seconds.
    pub processor_s: f64,
}

impl TimeToSuccess {
    /// Returns the times of a run from its log so far; levels that it has not reached are left out.
    ///
    /// # Errors
    /// If the log does not exist or cannot be read.
    pub fn of_run(folder: &RunFolder) -> Result<Vec<TimeToSuccess>, Error> {
        let updates = policy_updates(folder)?.collect::<Result<Vec<_>, Error>>()?;
        Ok(TimeToSuccess::of_updates(&updates))
    }

    /// Returns the times from a run's policy updates, which are in order.
    ///
    /// A level is reached for good at the first update whose success rate is at least the level and from
    /// which on the mean of all success rates is at least the level, too: a single lucky count is not enough.
    pub fn of_updates(updates: &[PolicyUpdate]) -> Vec<TimeToSuccess> {
        LEVELS.iter().filter_map(|&level| reached(updates, level)).collect()
    }

    /// Returns the time for each of [`LEVELS`]; `None` for a level that was not reached.
    pub fn by_level(times: &[TimeToSuccess]) -> [Option<&TimeToSuccess>; LEVELS.len()] {
        LEVELS.map(|level| times.iter().find(|time| time.success_rate == level))
    }
}

fn reached(updates: &[PolicyUpdate], level: f64) -> Option<TimeToSuccess> {
    let (mut sum, mut first) = (0.0, None);
    for (count, update) in (1_u32..).zip(updates.iter().rev()) {
        sum += update.success_rate;
        if update.success_rate >= level && sum / f64::from(count) >= level {
            first = Some(update);
        }
    }
    first.map(|update| TimeToSuccess {
        success_rate: level,
        environment_steps: update.environment_steps,
        wall_s: update.wall_s,
        processor_s: update.processor_s,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn steps(rates: &[f64]) -> Vec<(f64, u64)> {
        let update = |(number, &success_rate): (usize, &f64)| PolicyUpdate {
            environment_steps: 100 * (number as u64 + 1),
            success_rate,
            ..PolicyUpdate::default()
        };
        let updates: Vec<PolicyUpdate> = rates.iter().enumerate().map(update).collect();
        let reached = TimeToSuccess::of_updates(&updates);
        reached.iter().map(|one| (one.success_rate, one.environment_steps)).collect()
    }

    #[test]
    fn a_level_counts_once_it_is_kept() {
        assert_eq!(steps(&[0.1, 0.6, 0.4, 0.7, 0.92]), [(0.5, 200), (0.9, 500)]);
        assert_eq!(steps(&[0.1, 0.6, 0.1, 0.1, 0.2]), []);
        assert_eq!(
            steps(&[0.96, 0.99, 0.99, 1.0]),
            [(0.5, 100), (0.9, 100), (0.95, 100), (0.98, 200)]
        );
    }

    #[test]
    fn where_nobody_tells_success_no_level_is_reached() {
        assert_eq!(steps(&[f64::NAN, f64::NAN]), []);
        assert_eq!(steps(&[]), []);
    }
}
