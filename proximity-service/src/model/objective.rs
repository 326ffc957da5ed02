//! Objectives, in which learned reward models differ: the rows they see, their training minibatches, their loss,
//! and the rewards computed from their scores.

use networks::{RowScore, Squashing};
use protocol::seed::{self, Purpose, Stream};
use protocol::trajectory::Trajectory;
use rand::seq::SliceRandom;
use run::config::RewardConfig;

use super::input::Input;
use super::minibatch::{Losses, Minibatch, Positions};
use crate::reward::rewards;

/// Training objective of a model, and the rewards computed from its ensemble.
pub trait Objective: Sync {
    /// How the outputs of the ensemble become a proximity.
    const SQUASHING: Squashing;

    /// Creates the objective for some demonstrations.
    fn new(config: &RewardConfig, input: &Input, demonstrations: &[Trajectory]) -> Self;

    /// Returns the length in bytes of what training draws by position: a row, unless rows are composed of several.
    fn kept_bytes(input: &Input) -> usize {
        input.row_bytes()
    }

    /// Appends the rows of an episode for training, by default those that show how far it has come.
    fn append_training_rows(&self, input: &Input, seen: EpisodeView<'_>, rows: &mut Vec<u8>) {
        input.append_places(seen.observations, seen.actions, rows);
    }

    /// Appends the rows of an episode that its rewards are computed from, by default one per observation.
    fn append_scored_rows(&self, input: &Input, seen: EpisodeView<'_>, rows: &mut Vec<u8>) {
        input.append_observations(seen.observations, seen.actions, rows);
    }

    /// Returns the minibatches of offline training, in order.
    fn offline(&self, sampler: &Sampler<'_>) -> Vec<Positions>;

    /// Returns the minibatches of one online update, in order, by default pairs of both kinds of rows.
    fn online(&self, sampler: &Sampler<'_>, agent: usize, stream: &mut Stream) -> Vec<Positions> {
        sampler.online_pairs(agent, stream)
    }

    /// Returns the losses of one member's outputs on a minibatch and writes the gradients of their sum.
    fn losses(&self, minibatch: &Minibatch, outputs: &[f32], gradients: &mut [f32]) -> Losses;

    /// Returns the proximity of scored rows.
    fn proximity(rows: &[RowScore]) -> Vec<f32> {
        rows.iter().map(|row| Self::SQUASHING.proximity(row.mean)).collect()
    }

    /// Returns the rewards of an episode with `steps` steps, by default those of its proximity (Eq. 5).
    fn rewards(&self, rows: &[RowScore], _steps: usize, config: &RewardConfig) -> Vec<f32> {
        let proximity = Self::proximity(rows);
        let uncertainty: Vec<f32> = rows.iter().map(|row| row.standard_deviation).collect();
        rewards(&proximity, &uncertainty, config)
    }
}

/// The part of an episode that a model may see.
#[derive(Clone, Copy, Debug)]
pub struct EpisodeView<'a> {
    /// Observations, one after another.
    pub observations: &'a [u8],
    /// At least one action for each step between them, if the model sees actions.
    pub actions: &'a [u8],
}

/// Draws the positions of minibatches.
#[derive(Clone, Copy, Debug)]
pub struct Sampler<'a> {
    /// Batch size, samples and epochs.
    pub config: &'a RewardConfig,
    /// Seed of the run.
    pub run_seed: u64,
    /// Number of rows of the demonstrations.
    pub demonstrations: usize,
}

impl Sampler<'_> {
    /// Draws minibatches of pairs for offline training. An epoch has as many full batches as the demonstrations'
    /// rows fill. `draw` returns the positions of the given number of pairs.
    pub fn offline_pairs(&self, draw: impl Fn(usize, &mut Stream) -> Vec<usize>) -> Vec<Positions> {
        let RewardConfig { batch, pretraining_epochs, .. } = *self.config;
        let epoch = |epoch| {
            let purpose = Purpose::PretrainingBatches;
            let mut stream = seed::stream(self.run_seed, purpose, epoch, 0);
            let minibatch =
                |_| Positions { demonstrations: draw(batch, &mut stream), agent: Vec::new() };
            (0..self.demonstrations / batch).map(minibatch).collect::<Vec<_>>()
        };
        (0..pretraining_epochs).flat_map(epoch).collect()
    }

    /// Draws the minibatches of one online update, full batches of both kinds of rows. It samples rows of each kind
    /// without replacement: as many as the configuration says, or as there are of the rarer kind.
    pub fn online_pairs(&self, agent: usize, stream: &mut Stream) -> Vec<Positions> {
        let samples = self.config.samples.min(self.demonstrations).min(agent);
        let draw = |count, stream: &mut _| rand::seq::index::sample(stream, count, samples);
        let mut own = draw(self.demonstrations, stream).into_vec();
        let mut agent = draw(agent, stream).into_vec();
        // `sample` has shuffled them already; these draws are part of the weights of all recorded runs.
        own.shuffle(stream);
        agent.shuffle(stream);
        let size = self.config.batch;
        let pairs = own.chunks_exact(size).zip(agent.chunks_exact(size));
        pairs
            .map(|(own, agent)| Positions { demonstrations: own.to_vec(), agent: agent.to_vec() })
            .collect()
    }
}
