//! Which demonstrations a member of the ensemble learns from: all of them, or its own bootstrap resample.
//!
//! A resample draws whole demonstrations with replacement, since the rows of a demonstration are similar. If single
//! rows were drawn, every member would see something of nearly every demonstration.

use protocol::seed::{self, Purpose};
use rand::RngExt;
use run::config::RewardConfig;

use super::minibatch::Positions;

/// Mapping from drawn positions to the rows of demonstrations that a member sees.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Resamples {
    /// All members see the same minibatches of the original rows.
    Shared,
    /// Every member sees minibatches of its own resample, which has as many rows as the demonstrations.
    Own(Vec<Vec<usize>>),
}

impl Resamples {
    /// Draws the resamples of a configuration. `rows` has the number of rows of each demonstration, in order.
    pub(super) fn new(config: &RewardConfig, run_seed: u64, rows: &[usize]) -> Self {
        if !config.bootstrap {
            return Resamples::Shared;
        }
        let mut total = 0;
        let mut demonstrations = Vec::with_capacity(rows.len());
        for count in rows {
            demonstrations.push(total..total + count);
            total += count;
        }
        let resample = |member| {
            let mut stream = seed::stream(run_seed, Purpose::Resample, member, 0);
            let mut resample = Vec::with_capacity(total);
            while resample.len() < total {
                resample.extend(demonstrations[stream.random_range(0..rows.len())].clone());
            }
            resample.truncate(total);
            resample
        };
        Resamples::Own((0..config.ensemble as u64).map(resample).collect())
    }

    /// Returns the number of minibatches of a gradient step: one for all members, or one for each.
    pub(super) fn minibatches(&self) -> usize {
        match self {
            Resamples::Shared => 1,
            Resamples::Own(members) => members.len(),
        }
    }

    /// Replaces the drawn positions by the rows that a member sees there.
    pub(super) fn of_member(&self, member: usize, mut positions: Positions) -> Positions {
        if let Resamples::Own(members) = self {
            for position in &mut positions.demonstrations {
                *position = members[member][*position];
            }
        }
        positions
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{GoalProximity, Learned, RewardModel};
    use crate::tests::{assert_reproducible, config, learned, place, pretrained};

    #[test]
    fn a_resample_is_of_whole_demonstrations_and_each_member_has_another() {
        let bootstrapped = RewardConfig { bootstrap: true, ..config() };
        let rows = [3; 40];
        let resamples = Resamples::new(&bootstrapped, 7, &rows);
        let Resamples::Own(members) = &resamples else { panic!("{resamples:?}") };
        assert_eq!((members.len(), resamples.minibatches()), (5, 5));
        for member in members {
            assert_eq!(member.len(), 120);
            let whole = |rows: &[usize]| rows[0].is_multiple_of(3) && rows[2] == rows[0] + 2;
            assert!(member.chunks_exact(3).all(whole), "{member:?}");
            let mut seen: Vec<usize> = member.iter().map(|row| row / 3).collect();
            seen.sort_unstable();
            seen.dedup();
            // The expected number is (1 - 1/e) * 40, about 25.
            assert!((18..33).contains(&seen.len()), "{} of 40", seen.len());
        }
        assert_ne!(members[0], members[1]);
        assert_eq!(resamples, Resamples::new(&bootstrapped, 7, &rows));
        let drawn = Positions { demonstrations: vec![5, 0], agent: vec![9] };
        let own = resamples.of_member(1, drawn.clone());
        assert_eq!(own.demonstrations, [members[1][5], members[1][0]]);
        assert_eq!(own.agent, [9]);
        let shared = Resamples::new(&config(), 7, &rows);
        assert_eq!((shared.minibatches(), shared.of_member(0, drawn.clone())), (1, drawn));
    }

    #[test]
    fn bootstrapped_members_learn_and_threads_and_a_restore_change_no_bit() {
        let bootstrapped = RewardConfig { bootstrap: true, ..config() };
        assert_reproducible::<GoalProximity>(&bootstrapped);
        let mut model: Learned<GoalProximity> = learned(&bootstrapped, 2);
        assert_eq!(pretrained(&mut model).gradient_steps, 200);
        let near = model.estimate(&place(0.9, 0.0)).unwrap().proximity[0];
        assert!((near - 0.9).abs() < 0.1, "{near}");
    }
}
