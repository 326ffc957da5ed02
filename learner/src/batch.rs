//! The batch of one iteration, laid out for the policy update: one row per environment step.

use anyhow::{Result, ensure};
use networks::RunningNormalizer;
use protocol::ending::Ending;
use protocol::messages::Score;
use protocol::task::{Spec, floats};
use protocol::trajectory::{Encoded, Trajectory};
use run::process::Final;

use crate::reward_scale::{EpisodeRewards, RewardScale};

/// The batch of one iteration: rows in batch order, episodes one after another.
#[derive(Clone, Debug, Default)]
pub struct RolloutBatch {
    /// Observations acted on, each of the spec's length in bytes.
    pub observations: Vec<u8>,
    /// Actions taken, each of the spec's length in bytes.
    pub actions: Vec<u8>,
    /// Log-probability of each action under the policy that acted.
    pub log_probs: Vec<f32>,
    /// Reward of each step, as the policy learns from it.
    pub rewards: Vec<f32>,
    /// The episodes, in order.
    pub episodes: Vec<EpisodeRows>,
}

/// An episode's place in a [`RolloutBatch`].
#[derive(Clone, Debug)]
pub struct EpisodeRows {
    /// Number of steps, and so of rows.
    pub steps: usize,
    /// The final observation, after which no action was taken.
    pub last_observation: Vec<u8>,
    /// Whether the horizon ended the episode.
    pub truncated: bool,
}

impl RolloutBatch {
    /// Lays out trajectories and their scores, which must be in the same order.
    ///
    /// # Errors
    /// When the scores are not those of the trajectories; [`Final`] when a reward is not finite.
    pub fn new(trajectories: &[Encoded], scores: &[Score], spec: &Spec) -> Result<RolloutBatch> {
        ensure!(
            trajectories.len() == scores.len(),
            "expected {} scores, found {}",
            trajectories.len(),
            scores.len()
        );
        let mut batch = RolloutBatch::default();
        for (encoded, score) in trajectories.iter().zip(scores) {
            let trajectory = &encoded.trajectory;
            let expected = (trajectory.iteration, trajectory.lane, trajectory.episode);
            let found = (score.iteration, score.lane, score.episode);
            ensure!(
                found == expected,
                "expected the score of iteration, lane and episode {expected:?}, found {found:?}"
            );
            let steps = trajectory.steps as usize;
            ensure!(
                score.rewards.len() == steps,
                "lane {} episode {}: expected {steps} rewards, found {}",
                trajectory.lane,
                trajectory.episode,
                score.rewards.len()
            );
            if let Some(index) = score.rewards.iter().position(|reward| !reward.is_finite()) {
                let Trajectory { lane, episode, .. } = *trajectory;
                let (step, found) = (index + 1, score.rewards[index]);
                let message = format!(
                    "the reward model diverged: lane {lane} episode {episode} step {step}: expected a \
                     finite reward, found {found}"
                );
                return Err(Final(message).into());
            }
            let observations = trajectory.observations();
            let (acted_on, last) = observations.split_at(steps * spec.observation.bytes());
            batch.observations.extend(acted_on);
            batch.actions.extend(trajectory.actions());
            batch.log_probs.extend(floats(&trajectory.log_probs));
            batch.rewards.extend(&score.rewards);
            batch.episodes.push(EpisodeRows {
                steps,
                last_observation: last.to_vec(),
                truncated: trajectory.ending == Ending::Truncated as i32,
            });
        }
        Ok(batch)
    }

    /// Normalizes the observations as the policy sees them.
    pub fn normalize(&mut self, normalizer: &RunningNormalizer) {
        normalizer.normalize(&mut self.observations);
        for episode in &mut self.episodes {
            normalizer.normalize(&mut episode.last_observation);
        }
    }

    /// Divides the rewards by the running standard deviation of the discounted return.
    pub(crate) fn scale_rewards(
        &mut self,
        scale: &mut RewardScale,
        trajectories: &[Encoded],
        gamma: f64,
    ) {
        let mut rest = &mut self.rewards[..];
        let mut episodes = Vec::with_capacity(trajectories.len());
        for (encoded, episode) in trajectories.iter().zip(&self.episodes) {
            let (rewards, further) = rest.split_at_mut(episode.steps);
            episodes.push(EpisodeRewards { lane: encoded.trajectory.lane, rewards });
            rest = further;
        }
        scale.apply(&mut episodes, gamma);
    }

    /// Returns the number of rows.
    pub fn len(&self) -> usize {
        self.log_probs.len()
    }

    /// Returns whether there are no rows.
    pub fn is_empty(&self) -> bool {
        self.log_probs.is_empty()
    }
}
