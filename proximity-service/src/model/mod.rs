//! Reward models: what learns the reward and answers for it.

mod environment;
mod proximity;

use anyhow::Result;
use protocol::messages::{Estimates, RewardUpdate, Score};
use protocol::tensors::Tensors;
use protocol::trajectory::Encoded;

pub use environment::EnvironmentReward;
pub use proximity::GoalProximity;

/// A reward model. With PPO it makes a method.
pub trait RewardModel {
    /// Trains on the demonstrations alone (Algorithm 1, lines 2 to 5).
    fn pretrain(&mut self) -> RewardUpdate;

    /// Trains on the demonstrations and a batch (Algorithm 1, line 10).
    fn improve(&mut self, iteration: u64, batch: &[Encoded]) -> RewardUpdate;

    /// Scores a batch (Algorithm 1, line 8). Depends on the batch and the model's version alone.
    fn score(&self, iteration: u64, batch: &[Encoded]) -> Vec<Score>;

    /// Proximity and uncertainty of any observations. Changes nothing.
    fn estimate(&self, observations: &[u8]) -> Estimates;

    /// Hash of all weights.
    fn sha256(&self) -> String;

    /// Everything carried from one update to the next.
    fn save(&self) -> Tensors;

    /// Takes over what [`RewardModel::save`] gave.
    ///
    /// # Errors
    /// When the arrays are not those of this model.
    fn restore(&mut self, tensors: &Tensors) -> Result<(), String>;
}
