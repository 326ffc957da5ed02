//! The environment's own reward, as recorded in the trajectories: an upper reference, not imitation.

use protocol::messages::{Estimates, RewardUpdate, Score};
use protocol::task::floats;
use protocol::tensors::Tensors;
use protocol::trajectory::Encoded;

use super::RewardModel;

/// The environment's own reward; there is nothing to learn.
#[derive(Clone, Copy, Debug)]
pub struct EnvironmentReward {
    /// Length of an observation in bytes.
    pub observation_bytes: usize,
}

impl RewardModel for EnvironmentReward {
    fn pretrain(&mut self) -> RewardUpdate {
        RewardUpdate { weights_sha256: self.sha256(), ..RewardUpdate::default() }
    }

    fn improve(&mut self, iteration: u64, _batch: &[Encoded]) -> RewardUpdate {
        RewardUpdate { iteration, weights_sha256: self.sha256(), ..RewardUpdate::default() }
    }

    fn score(&self, iteration: u64, batch: &[Encoded]) -> Vec<Score> {
        let score = |encoded: &Encoded| Score {
            iteration,
            lane: encoded.key.lane,
            episode: encoded.key.episode,
            model_version: 0,
            rewards: floats(&encoded.trajectory.environment_rewards).collect(),
            proximity: Vec::new(),
            uncertainty: Vec::new(),
        };
        batch.iter().map(score).collect()
    }

    fn estimate(&self, observations: &[u8]) -> Estimates {
        let unknown = vec![0.0; observations.len() / self.observation_bytes];
        Estimates { model_version: 0, proximity: unknown.clone(), uncertainty: unknown }
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
