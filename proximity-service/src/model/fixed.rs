//! Rewards that nothing is learned for: the environment's own, as recorded in the trajectories, and
//! none, for policy learners that need no reward.

use std::time::Duration;

use anyhow::{Result, bail};
use protocol::messages::{Estimates, RewardUpdate, Score};
use protocol::task::floats;
use protocol::tensors::Tensors;
use protocol::trajectory::Encoded;
use run::process::Final;

use super::{RewardModel, Slice};

/// A reward that stays as it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FixedReward {
    /// The environment's own: an upper reference, not imitation.
    Environment,
    /// Zero.
    None,
}

impl RewardModel for FixedReward {
    fn pretrain(&mut self, _time: Duration) -> Result<Slice, Final> {
        let weights_sha256 = self.sha256();
        Ok(Slice::Done(RewardUpdate { weights_sha256, ..RewardUpdate::default() }))
    }

    fn improve(&mut self, iteration: u64, _batch: &[Encoded]) -> Result<RewardUpdate, Final> {
        let weights_sha256 = self.sha256();
        Ok(RewardUpdate { iteration, weights_sha256, ..RewardUpdate::default() })
    }

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

    fn save(&self) -> Tensors {
        Tensors::default()
    }

    fn restore(&mut self, _tensors: &Tensors) -> Result<(), String> {
        Ok(())
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
