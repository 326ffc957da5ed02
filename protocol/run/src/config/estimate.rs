//! Estimates what a run of a configuration takes of a machine: bytes of memory and passes of rows
//! through networks. The estimate is a coarse upper bound on purpose: each demonstration counts as
//! long as the longest episode. It serves to tell a run that fits from one that cannot.

use super::{Discriminator, NetworkSize, RunConfig};

/// Bytes of a process that has not learned anything yet: program, stacks, buffers, its part of the bus.
const PROCESS_BYTES: f64 = 60e6;

/// Bytes of a number in a network.
const NUMBER_BYTES: f64 = 4.0;

/// Copies of a network's parameters in the learner, besides gradients: its own, two moments, two packed for the
/// kernels, two to be published, and most of these again while a checkpoint is written. This number and those
/// of members and actors are measured peaks of processes with networks so large that nothing else matters.
const LEARNER_VERSIONS: f64 = 11.0;

/// Copies of an ensemble member's parameters in the proximity service, including its gradient and what scoring uses.
const MEMBER_VERSIONS: f64 = 18.0;

/// Copies of the parameters of a member's prior, which is not trained: its own, packed, and one
/// while a checkpoint is written.
const PRIOR_VERSIONS: f64 = 3.0;

/// Copies of the policy's parameters in an actor: the newest two versions, each as received and as used for acting.
const ACTOR_VERSIONS: f64 = 10.0;

/// Rows for which a gradient or a score is computed at once.
const SHARD_ROWS: f64 = 128.0;

/// Bytes of a step in a batch besides observation and action: rewards, values, advantages, names.
const STEP_BYTES: f64 = 64.0;

/// Copies of what a reward model sees of the demonstrations: as they were read, concatenated to
/// compute their moments, and as it keeps them.
const DEMONSTRATION_COPIES: f64 = 3.0;

/// Copies of what a reward model keeps of the agent: its own, and two while a checkpoint is written or read.
const EXPERIENCE_COPIES: f64 = 3.0;

/// Comparisons of two states that take about as long as a row's pass through a network.
const COMPARISONS_PER_PASS: f64 = 100.0;

/// Bytes of the position of a row that is drawn.
const POSITION_BYTES: f64 = 8.0;

/// What a run takes of a machine.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// Memory of the learner, bytes.
    pub learner_bytes: f64,
    /// Memory of the proximity service, bytes.
    pub service_bytes: f64,
    /// Memory of each actor, bytes.
    pub actor_bytes: f64,
    /// Number of actors.
    pub actors: f64,
    /// Environment steps of demonstrations, training and evaluation.
    pub environment_steps: f64,
    /// Optimizer steps of the policy and of every member of the ensemble.
    pub gradient_steps: f64,
    /// Rows that pass through a network, forward or both forward and backward, or work that takes as long.
    pub row_passes: f64,
}

impl Estimate {
    /// Returns the memory of all processes, bytes.
    pub fn bytes(&self) -> f64 {
        self.learner_bytes + self.service_bytes + self.actors * self.actor_bytes
    }
}

/// The computations of a run.
#[derive(Clone, Copy, Debug, Default)]
pub struct Work {
    /// Optimizer steps.
    pub gradient_steps: f64,
    /// Rows that pass through a network for them.
    pub row_passes: f64,
}

/// What a policy learner holds in memory, besides the policy.
#[derive(Clone, Copy, Debug, Default)]
pub struct Memory {
    /// Rows of a minibatch.
    pub minibatch: f64,
    /// Copies of the demonstrations.
    pub copies: f64,
    /// Transitions kept in the replay buffer.
    pub kept: usize,
}

impl RunConfig {
    /// Estimates what a run of this configuration takes on a machine with `cores` cores.
    pub fn estimate(&self, cores: usize) -> Estimate {
        let [policy, reward] = [self.learner.work(self), self.reward_work()];
        let horizon = f64::from(self.task.spec().horizon_steps);
        let shown = if self.imitates() && self.demonstrations.file.is_none() {
            self.demonstration_rows()
        } else {
            0.0
        };
        Estimate {
            learner_bytes: self.learner_bytes(),
            service_bytes: self.service_bytes(cores),
            actor_bytes: PROCESS_BYTES
                + ACTOR_VERSIONS * NUMBER_BYTES * self.policy_size().parameters,
            actors: self.resources.actors as f64,
            environment_steps: shown
                + self.steps_wanted() as f64
                + self.evaluation.episodes as f64 * horizon,
            gradient_steps: policy.gradient_steps + reward.gradient_steps,
            row_passes: policy.row_passes + reward.row_passes,
        }
    }

    /// Returns the largest number of observations that all demonstrations can have.
    pub(super) fn demonstration_rows(&self) -> f64 {
        self.demonstrations.episodes as f64 * (f64::from(self.task.spec().horizon_steps) + 1.0)
    }

    /// Returns the bytes of the steps of a rollout that is learned from, or of two rollouts if actors run ahead.
    fn rollout_bytes(&self) -> f64 {
        let spec = self.task.spec();
        let step = 2 * spec.observation.bytes() + spec.action.bytes();
        let rollouts = 1.0 + self.rollout.lag as f64;
        rollouts * self.iteration_steps() as f64 * (step as f64 + STEP_BYTES)
    }

    /// Returns the bytes of a network that is trained on minibatches of `minibatch` rows. Each
    /// shard of a minibatch has a gradient and the numbers of its rows, forward and backward.
    fn trained_bytes(size: NetworkSize, minibatch: f64) -> f64 {
        let shards = (minibatch / SHARD_ROWS).ceil().max(2.0);
        let rows = shards * SHARD_ROWS.min(minibatch);
        NUMBER_BYTES
            * (size.parameters * (LEARNER_VERSIONS + shards) + 2.0 * rows * size.row_numbers)
    }

    fn learner_bytes(&self) -> f64 {
        let spec = self.task.spec();
        let rows = self.demonstration_rows();
        let observation = spec.observation.bytes() as f64;
        let transition = observation + spec.action.bytes() as f64 + STEP_BYTES;
        let Memory { minibatch, copies, kept } = self.learner.memory(self);
        let kept = (kept as f64).min(self.steps as f64 + self.iteration_steps() as f64);
        let mut bytes = Self::trained_bytes(self.policy_size(), minibatch);
        if let (Some(size), Some(inverse)) = (self.inverse_dynamics_size(), &self.inverse_dynamics)
        {
            let drawn = inverse.samples.min(inverse.experience) as f64;
            bytes += Self::trained_bytes(size, (inverse.batch as f64).min(drawn));
            bytes += 2.0 * observation * drawn;
        }
        let q_functions = self.q_function_size();
        bytes += q_functions.map_or(0.0, |size| 2.0 * Self::trained_bytes(size, minibatch));
        bytes += copies * rows * observation + kept * transition;
        PROCESS_BYTES + self.rollout_bytes() + bytes
    }

    fn service_bytes(&self, cores: usize) -> f64 {
        let (model, observation) = (self.reward.model, self.task.observation.bytes() as f64);
        let own = if model.trains {
            self.ensemble_bytes(cores)
        } else if model.imitates {
            DEMONSTRATION_COPIES * self.demonstration_rows() * observation
        } else {
            0.0
        };
        PROCESS_BYTES + self.rollout_bytes() + own
    }

    /// Returns the bytes of all ensembles of the reward model, each with the rows that it is trained on.
    fn ensemble_bytes(&self, cores: usize) -> f64 {
        let reward = &self.reward;
        let [frames, beside] = self.reward_row();
        let row = (frames * self.task.observation.bytes() + 4 * beside) as f64;
        let (size, members) = (self.member_size(), self.reward_members());
        let pairs = if reward.model.pairs { 2.0 } else { 1.0 };
        let minibatch = pairs * 2.0 * (reward.batch as f64).min(self.demonstration_rows());
        // A member computes a whole minibatch at once.
        let versions = MEMBER_VERSIONS + if reward.prior > 0.0 { PRIOR_VERSIONS } else { 0.0 };
        let numbers = size.parameters * versions + 2.0 * minibatch * size.row_numbers;
        let threads = match self.resources.service_threads {
            0 => cores,
            threads => threads,
        };
        let scored = threads as f64 * SHARD_ROWS * size.row_numbers;
        let rows = self.demonstration_rows();
        let drawn = reward.pretraining_epochs as f64 * rows * pairs * POSITION_BYTES;
        let experience = EXPERIENCE_COPIES * reward.experience_kept() as f64;
        let kept = experience + DEMONSTRATION_COPIES * rows;
        NUMBER_BYTES * (members * numbers + scored) + self.ensembles() * row * kept + drawn
    }

    /// Returns the number of ensembles of the reward model.
    fn ensembles(&self) -> f64 {
        match self.reward.model.discriminator {
            Discriminator::BesideProximity => 2.0,
            Discriminator::None | Discriminator::Alone => 1.0,
        }
    }

    /// Returns the number of members of all ensembles.
    fn reward_members(&self) -> f64 {
        self.ensembles() * self.reward.ensemble as f64
    }

    fn reward_work(&self) -> Work {
        let reward = &self.reward;
        let (rows, iterations) = (self.demonstration_rows(), self.iterations() as f64);
        let scored = iterations * self.iteration_steps() as f64;
        if !reward.model.trains {
            let compared = if reward.model.imitates { rows / reward.segments as f64 } else { 0.0 };
            let row_passes = scored * compared / COMPARISONS_PER_PASS;
            return Work { row_passes, ..Work::default() };
        }
        let (members, batch) = (self.reward_members(), reward.batch as f64);
        let pairs = if reward.model.pairs { 2.0 } else { 1.0 };
        let offline = reward.pretraining_epochs as f64 * rows;
        let samples = if reward.model.online { reward.samples as f64 } else { 0.0 };
        let online = iterations * samples.min(rows);
        let networks = if reward.prior > 0.0 { 2.0 * members } else { members };
        Work {
            gradient_steps: members * (offline + online) / batch,
            row_passes: networks * (pairs * (offline + 2.0 * online) + scored),
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::tasks::configuration;

    fn service_bytes(method: &str, setting: &str) -> f64 {
        let settings = [format!("method={method}"), setting.to_owned()];
        configuration("navigation", None, &settings).unwrap().estimate(2).service_bytes
    }

    /// Returns by how many observations of NAVIGATION the service's memory grows.
    fn observations_more(method: &str, settings: [&str; 2]) -> f64 {
        let [before, after] = settings.map(|setting| service_bytes(method, setting));
        ((after - before) / 361.0).round()
    }

    #[test]
    fn every_ensemble_keeps_what_it_sees_and_writes_it_down() {
        let experience = ["reward.experience=10000", "reward.experience=11000"];
        assert_eq!(observations_more("goal-proximity", experience), 3_000.0);
        assert_eq!(observations_more("proximity-discriminator", experience), 6_000.0);
        let [learns, does_not] = ["goal-proximity", "no-online"].map(|method| {
            let bytes = service_bytes(method, "seed=1");
            (bytes / 361.0).round()
        });
        assert_eq!(learns - does_not, 3.0 * 10_000.0);
    }

    #[test]
    fn states_are_compared_with_all_that_are_demonstrated() {
        let row_passes = |method: &str, episodes: u64| {
            let settings =
                [format!("method={method}"), format!("demonstrations.episodes={episodes}")];
            configuration("navigation", None, &settings).unwrap().reward_work().row_passes
        };
        let whole = row_passes("nearest-state", 250);
        assert!(whole > 0.0);
        assert_eq!(row_passes("nearest-state", 500), 2.0 * whole);
        assert!((10.0 * row_passes("segment-matching", 250) / whole - 1.0).abs() < 1e-9);
        assert_eq!(row_passes("environment-reward", 250), 0.0);
    }

    #[test]
    fn a_model_that_trains_nothing_keeps_demonstrations_if_it_imitates() {
        let episodes = ["demonstrations.episodes=250", "demonstrations.episodes=260"];
        assert_eq!(observations_more("nearest-state", episodes), 3.0 * 1_010.0);
        assert_eq!(observations_more("environment-reward", episodes), 0.0);
    }
}
