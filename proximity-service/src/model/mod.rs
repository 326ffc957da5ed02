//! Reward models: what learns the reward and answers for it.

mod bootstrap;
mod discriminator;
mod ensemble;
mod fixed;
mod input;
mod learned;
mod minibatch;
mod nearest;
mod objective;
mod offline;
mod penalty;
mod proximity;
mod proximity_discriminator;
mod ranking;
mod registry;
mod temporal_distance;
mod threads;

use std::time::Duration;

use anyhow::Result;
use protocol::messages::{Estimates, RewardUpdate, Score};
use protocol::tensors::Tensors;
use protocol::trajectory::Encoded;
use run::process::Final;

pub use discriminator::Discriminator;
pub use ensemble::TrainedEnsemble;
pub use fixed::FixedReward;
pub use input::{Input, Rows};
pub use learned::Learned;
pub use minibatch::{Losses, Minibatch, MinibatchRows};
pub use nearest::NearestState;
pub use objective::{EpisodeView, Learning, Objective};
pub use offline::Slice;
pub use penalty::GradientPenalty;
pub use proximity::GoalProximity;
pub use proximity_discriminator::ProximityDiscriminator;
pub use ranking::Ranking;
pub use registry::of_run;
pub use temporal_distance::TemporalDistance;

/// A reward model. With a policy learner it makes a method. One that trains nothing scores batches, and
/// has nothing else to do.
pub trait RewardModel {
    /// Goes on with training on the demonstrations alone (Algorithm 1, lines 2 to 5), for about as long
    /// as said and at least one gradient step.
    ///
    /// # Errors
    /// [`Final`] when a loss or gradient is no number any more; the model is of no use then.
    fn pretrain(&mut self, _time: Duration) -> Result<Slice, Final> {
        let weights_sha256 = self.sha256();
        Ok(Slice::Done(RewardUpdate { weights_sha256, ..RewardUpdate::default() }))
    }

    /// Trains on the demonstrations and a batch (Algorithm 1, line 10).
    ///
    /// # Errors
    /// As [`RewardModel::pretrain`].
    fn improve(&mut self, iteration: u64, _batch: &[Encoded]) -> Result<RewardUpdate, Final> {
        let weights_sha256 = self.sha256();
        Ok(RewardUpdate { iteration, weights_sha256, ..RewardUpdate::default() })
    }

    /// Scores a batch (Algorithm 1, line 8). Depends on the batch and the model's version alone.
    fn score(&self, iteration: u64, batch: &[Encoded]) -> Vec<Score>;

    /// Proximity and uncertainty of any observations. Changes nothing.
    ///
    /// # Errors
    /// When the model cannot tell them from single observations.
    fn estimate(&self, observations: &[u8]) -> Result<Estimates>;

    /// The ensemble that it learns; none where it learns none, or several.
    fn ensemble(&self) -> Option<&TrainedEnsemble> {
        None
    }

    /// Hash of all weights.
    fn sha256(&self) -> String;

    /// Everything carried from one update to the next, and from one slice of offline training.
    fn save(&self) -> Tensors {
        Tensors::default()
    }

    /// Takes over what [`RewardModel::save`] gave.
    ///
    /// # Errors
    /// When the arrays are not those of this model.
    fn restore(&mut self, _tensors: &Tensors) -> Result<(), String> {
        Ok(())
    }
}
