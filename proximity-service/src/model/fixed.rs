//! Rewards without learning: the environment's own, as recorded in the trajectories, and zero, for policy learners
//! that need no reward.

use anyhow::{Result, bail};
use protocol::messages::{Estimates, Score};
use protocol::task::floats;
use protocol::trajectory::Encoded;

use super::RewardModel;

/// A reward that is not learned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FixedReward {
    /// The environment's own reward, without imitation.
    Environment,
    /// A reward of zero.
    None,
}

impl RewardModel for FixedReward {
    fn score(&self, iteration: u64, batch: &[Encoded]) -> Vec<Score> {
        let rewards = |encoded: &Encoded| match self {
            FixedReward::Environment => floats(&encoded.trajectory.environment_rewards).collect(),
            FixedReward::None => vec![0.0; encoded.trajectory.steps as usize],
        };
        let score = |encoded: &Encoded| Score {
            iteration,
            lane: encoded.key.lane,
            episode: encoded.key.episode,
            model_version: 0,
            rewards: rewards(encoded),
            proximity: Vec::new(),
            uncertainty: Vec::new(),
        };
        batch.iter().map(score).collect()
    }

    fn estimate(&self, _observations: &[u8]) -> Result<Estimates> {
        bail!("expected a reward model of single states, found one that learns nothing")
    }

    fn sha256(&self) -> String {
        protocol::weights::sha256([])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::{place, walk};
    use protocol::trajectory::{Source, Trajectory};

    #[test]
    fn a_step_earns_what_was_recorded_or_nothing() {
        let environment_rewards = [-1.0_f32, 0.5].map(f32::to_le_bytes).repeat(5).concat().into();
        let walked = Trajectory { environment_rewards, ..walk(0.0, Source::Training) };
        let batch = [Encoded::encode(walked)];
        let rewards = |model: FixedReward| model.score(0, &batch)[0].rewards.clone();
        assert_eq!(rewards(FixedReward::Environment), [-1.0, 0.5].repeat(5));
        assert_eq!(rewards(FixedReward::None), [0.0; 10]);
        assert!(FixedReward::None.estimate(&place(0.5, 0.0)).is_err());
    }
}
