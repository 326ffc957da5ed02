//! Policy learners, which improve a policy once per iteration, from a batch or from demonstrations.

mod bc;
mod bco;
mod cloning;
mod policy_trainer;
pub mod ppo;
mod replay_buffer;
mod sqil;

use std::fmt::Display;
use std::ops::AddAssign;

use anyhow::Result;
use networks::{ActorCritic, PolicyArchitecture, RunningNormalizer};
use protocol::messages::Score;
use protocol::seed::{self, Purpose};
use protocol::tensors::Tensors;
use protocol::trajectory::{Encoded, Trajectory};
use run::config::RunConfig;
use run::process::Final;

use crate::state::PolicyState;

/// A policy learner. Together with a reward model it is a method.
pub trait PolicyLearner: Send {
    /// Improves the policy with the batch of an iteration and its scores, on the caller's rayon pool.
    ///
    /// # Errors
    /// When the scores are not those of the trajectories; [`Final`] when a loss or gradient is NaN or infinite,
    /// which leaves the policy unusable.
    fn update(
        &mut self,
        policy: &mut PolicyState,
        trajectories: &[Encoded],
        scores: &[Score],
        schedule: &Schedule,
    ) -> Result<Metrics>;

    /// Returns whether there is nothing more to learn, even before the run's last iteration.
    fn is_finished(&self) -> bool {
        false
    }

    /// Takes in the batch of an earlier iteration, when a run whose learner has a replay buffer is resumed.
    fn remember(&mut self, _trajectories: &[Encoded]) {}

    /// Adds everything carried from one update to the next, except what [`PolicyLearner::remember`] takes in.
    fn save(&self, tensors: &mut Tensors);

    /// Restores what [`PolicyLearner::save`] added.
    ///
    /// # Errors
    /// When the arrays are not those of this learner.
    fn restore(&mut self, tensors: &Tensors) -> Result<(), String>;
}

type Constructor = fn(Setup<'_>) -> Box<dyn PolicyLearner>;

/// One line for each name in [`run::config::LEARNERS`].
const LEARNERS: &[(&str, Constructor)] = &[
    ("ppo", |setup| Box::new(ppo::Ppo::new(setup))),
    ("bc", |setup| Box::new(bc::Bc::new(setup))),
    ("bco", |setup| Box::new(bco::Bco::new(setup))),
    ("sqil", |setup| Box::new(sqil::Sqil::new(setup))),
];

const IN_BOTH_TABLES: &str = "a test holds both tables together";

/// What an update depends on besides its data and configuration.
#[derive(Clone, Copy, Debug)]
pub struct Schedule {
    /// Seed of the run.
    pub run_seed: u64,
    /// The iteration, which names the random streams.
    pub iteration: u64,
    /// Adam's learning rate.
    pub learning_rate: f64,
}

/// Creates the policy learner of a configuration, and the policy that it starts with.
pub fn create(
    config: &RunConfig,
    demonstrations: &[Trajectory],
) -> (Box<dyn PolicyLearner>, PolicyState) {
    let spec = config.task.spec();
    let network =
        ActorCritic::new(spec.observation, spec.action, &PolicyArchitecture::from(&config.policy));
    let mut stream = seed::stream(config.seed, Purpose::PolicyWeights, 0, 0);
    let parameters = network.initial_parameters(&mut stream);
    let normalized = spec.observation.normalized(config.policy.normalize_observations);
    let normalizer = match config.learner.imitates() {
        // A learner that imitates demonstrations itself normalizes by the demonstrations' moments throughout the run.
        true => {
            let observations = demonstrations.iter().map(Trajectory::observations);
            RunningNormalizer::of_demonstrations(normalized, observations)
        }
        false => RunningNormalizer::new(normalized),
    };
    let setup = Setup { config, network, normalizer: &normalizer, demonstrations };
    let name = config.learner.name();
    let (_, construct) = LEARNERS.iter().find(|(known, _)| *known == name).expect(IN_BOTH_TABLES);
    (construct(setup), PolicyState { parameters, normalizer })
}

/// What a policy learner is made from.
struct Setup<'a> {
    /// The run's configuration.
    config: &'a RunConfig,
    /// The policy network.
    network: ActorCritic,
    /// The policy's initial normalizer of observations.
    normalizer: &'a RunningNormalizer,
    /// The demonstrations; empty for a learner that needs none.
    demonstrations: &'a [Trajectory],
}

/// Metrics of one update, means over its minibatches.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Metrics {
    /// Loss of the policy: PPO's clipped surrogate, the mean negative log-likelihood of actions, or a soft
    /// actor-critic's mean of `temperature x log-probability - Q`; soft Q-learning has none.
    pub policy_loss: f64,
    /// Loss of values, or of Q-functions.
    pub value_loss: f64,
    /// Entropy of the policy, nats.
    pub entropy: f64,
    /// Mean of `(ratio - 1) - ln ratio`, nats.
    pub approximate_kl: f64,
    /// Share of samples outside the clip range.
    pub clip_fraction: f64,
    /// Norm of the gradient before clipping.
    pub gradient_norm: f64,
    /// Loss on held-out demonstrations; 0 for learners that hold none out.
    pub held_out_loss: f64,
}

impl Metrics {
    /// Refuses a gradient step or a pass with a loss, entropy, divergence or norm that is NaN or infinite.
    ///
    /// # Errors
    /// [`Final`], with the loss or norm and the place where it occurred.
    pub fn expect_finite(&self, place: impl Display) -> Result<(), Final> {
        let metrics = [
            ("policy loss", self.policy_loss),
            ("value loss", self.value_loss),
            ("entropy", self.entropy),
            ("approximate KL", self.approximate_kl),
            ("gradient norm", self.gradient_norm),
            ("held-out loss", self.held_out_loss),
        ];
        match metrics.into_iter().find(|(_, metric)| !metric.is_finite()) {
            None => Ok(()),
            Some((name, found)) => {
                let message = format!("expected finite metrics, found {name} {found}, {place}");
                Err(Final(format!("the learner diverged: {message}")))
            }
        }
    }

    /// Divides every metric, to turn a sum into a mean.
    pub fn divided_by(&self, count: f64) -> Metrics {
        Metrics {
            policy_loss: self.policy_loss / count,
            value_loss: self.value_loss / count,
            entropy: self.entropy / count,
            approximate_kl: self.approximate_kl / count,
            clip_fraction: self.clip_fraction / count,
            gradient_norm: self.gradient_norm / count,
            held_out_loss: self.held_out_loss / count,
        }
    }
}

/// Adds the metrics of another minibatch, shard or row.
impl AddAssign for Metrics {
    fn add_assign(&mut self, other: Metrics) {
        self.policy_loss += other.policy_loss;
        self.value_loss += other.value_loss;
        self.entropy += other.entropy;
        self.approximate_kl += other.approximate_kl;
        self.clip_fraction += other.clip_fraction;
        self.gradient_norm += other.gradient_norm;
        self.held_out_loss += other.held_out_loss;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tables_name_the_same_learners() {
        let names = LEARNERS.iter().map(|(name, _)| *name);
        assert!(names.eq(run::config::LEARNERS.iter().map(|learner| learner.name())));
    }
}
