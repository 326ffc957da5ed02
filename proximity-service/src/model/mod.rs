//! Reward models, learned or fixed, which score episodes.

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
pub use ensemble::TrainableEnsemble;
pub use fixed::FixedReward;
pub use input::{Input, Rows};
pub use learned::Learned;
pub use minibatch::{Losses, Minibatch, Positions};
pub use nearest::NearestState;
pub use objective::{EpisodeView, Objective, Sampler};
pub use offline::Slice;
pub use penalty::GradientPenalty;
pub use proximity::GoalProximity;
pub use proximity_discriminator::ProximityDiscriminator;
pub use ranking::Ranking;
pub use registry::of_run;
pub use temporal_distance::TemporalDistance;

/// A reward model. Together with a policy learner it makes a method. One that trains nothing only scores.
pub trait RewardModel {
    /// Continues training on the demonstrations alone (Algorithm 1, lines 2 to 5), for about `time` and at least
    /// one gradient step.
    ///
    /// # Errors
    /// [`Final`] when a loss or a gradient is not finite; the model is unusable then.
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

    /// Scores a batch (Algorithm 1, line 8). The result depends only on the batch and the model's version.
    fn score(&self, iteration: u64, batch: &[Encoded]) -> Vec<Score>;

    /// Returns the proximity and uncertainty of any observations, without changing the model.
    ///
    /// # Errors
    /// When the model cannot score single observations.
    fn estimate(&self, observations: &[u8]) -> Result<Estimates>;

    /// Returns the ensemble that the model learns; `None` if it learns none or several.
    fn ensemble(&self) -> Option<&TrainableEnsemble> {
        None
    }

    /// Returns the hash of the trained weights, or of the demonstrated states for the nearest-state model.
    fn sha256(&self) -> String;

    /// Returns the state carried from one update to the next, and from one slice of offline training to the next.
    fn save(&self) -> Tensors {
        Tensors::default()
    }

    /// Restores what [`RewardModel::save`] returned.
    ///
    /// # Errors
    /// When the arrays do not fit this model.
    fn restore(&mut self, _tensors: &Tensors) -> Result<(), String> {
        Ok(())
    }
}
