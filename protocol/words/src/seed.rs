//! Every random stream of a run, derived from the run's seed.
//!
//! A stream is named by (run seed, purpose, major, minor). The name itself is the key of a
//! counter-based generator, so streams never overlap, none has to be saved in a checkpoint, and any
//! process can open any of them at any time.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

/// The generator behind every stream.
pub type Stream = ChaCha8Rng;

/// The purpose of a stream. The numbers are part of what a recorded run means: never reuse one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u64)]
pub enum Purpose {
    /// Initial weights of the policy.
    PolicyWeights = 1,
    /// Initial weights of the reward model; major is the ensemble member.
    RewardWeights = 2,
    /// An environment's episode; major is the lane, minor the episode.
    TrainingEpisode = 3,
    /// Actions sampled in a training episode; major is the lane, minor the episode.
    TrainingActions = 4,
    /// An evaluation episode; major is the lane, minor the episode.
    EvaluationEpisode = 5,
    /// Actions sampled in an evaluation episode; major is the lane, minor the episode.
    EvaluationActions = 6,
    /// A demonstration; major is the lane, minor the episode.
    Demonstration = 7,
    /// Choice of the demonstrations that a run uses from a file.
    DemonstrationSubset = 8,
    /// Minibatches of the policy update; major is the iteration, minor the epoch.
    PolicyMinibatches = 9,
    /// Batches of offline reward-model training; major is the epoch.
    PretrainingBatches = 10,
    /// Batches of online reward-model training; major is the iteration, minor the member if each draws its own.
    ImprovementBatches = 11,
    /// Choice of the demonstrations held out from behavioral cloning.
    HeldOutDemonstrations = 12,
    /// Minibatches of behavioral cloning; major is the iteration, minor the pass.
    CloningBatches = 13,
    /// Initial weights of the inverse dynamics model.
    InverseDynamicsWeights = 14,
    /// Transitions the inverse dynamics model is trained on; major is the iteration.
    InverseDynamicsBatches = 15,
    /// Initial weights of the Q-functions; major is the function.
    QWeights = 16,
    /// Transitions drawn from the replay buffer and actions sampled at them; major is the update.
    Replay = 17,
    /// Choice of the demonstrations that an ensemble member learns from; major is the member.
    Resample = 18,
    /// Weights of an ensemble member's prior; major is the member.
    RewardPrior = 19,
}

/// Opens the stream named by its four parts.
pub fn stream(run_seed: u64, purpose: Purpose, major: u64, minor: u64) -> Stream {
    let mut key = [0; 32];
    for (part, number) in key.chunks_exact_mut(8).zip([run_seed, purpose as u64, major, minor]) {
        part.copy_from_slice(&number.to_le_bytes());
    }
    ChaCha8Rng::from_seed(key)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_chacha::rand_core::Rng;

    #[test]
    fn streams_differ_in_every_part_of_their_name() {
        let draw = |seed, purpose, major, minor| stream(seed, purpose, major, minor).next_u64();
        let base = draw(1, Purpose::TrainingEpisode, 2, 3);
        assert_eq!(base, draw(1, Purpose::TrainingEpisode, 2, 3));
        assert_ne!(base, draw(2, Purpose::TrainingEpisode, 2, 3));
        assert_ne!(base, draw(1, Purpose::TrainingActions, 2, 3));
        assert_ne!(base, draw(1, Purpose::TrainingEpisode, 3, 3));
        assert_ne!(base, draw(1, Purpose::TrainingEpisode, 2, 4));
    }
}
