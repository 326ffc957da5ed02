//! Rewards that nothing is learned for: the environment's own, as recorded in the trajectories, and
//! none, for policy learners that need no reward.

use anyhow::{Result, bail};
use protocol::messages::{Estimates, RewardUpdate, Score};
use protocol::task::floats;
use protocol::tensors::Tensors;
use protocol::trajectory::Encoded;

use super::RewardModel;

/// A reward that stays as it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FixedReward {
    /// The environment's own: an upper reference, not imitation.
    Environment,
    /// Zero.
    None,
}

impl RewardModel for FixedReward {
    fn pretrain(&mut self) -> RewardUpdate {
        RewardUpdate { weights_sha256: self.sha256(), ..RewardUpdate::default() }
    }

    fn improve(&mut self, iteration: u64, _batch: &[Encoded]) -> RewardUpdate {
        RewardUpdate { iteration, weights_sha256: self.sha256(), ..RewardUpdate::default() }
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
