//! A trajectory: one whole episode, the unit that actors publish, the log keeps and learning uses.
//!
//! The encoded bytes of this message are written once, by the actor, into shared memory; the learner appends those
//! same bytes to the log. Packed `repeated float` fields of the schema are declared as [`Bytes`] here, which gives the
//! same bytes on the wire without converting each number.

use bytes::Bytes;
use prost::Message;

use crate::dropped::shortened;
use crate::ending::Ending;
use crate::error::FOUND_CHARS;
use crate::task::{ActionSpec, ObservationSpec, Spec};
use crate::{Error, seed};

/// Upper bound on the bytes of an encoded trajectory besides those of its steps: names, shapes and lengths.
const HEAD_BYTES: u64 = 1 << 10;

/// One whole episode: `steps` actions and one more observation than actions.
#[derive(Clone, PartialEq, Message)]
pub struct Trajectory {
    /// Name of the task.
    #[prost(string, tag = "1")]
    pub task: String,
    /// Who acted, and what for.
    #[prost(enumeration = "Source", tag = "2")]
    pub source: i32,
    /// Iteration of the rollout it belongs to; 0 for demonstrations.
    #[prost(uint64, tag = "3")]
    pub iteration: u64,
    /// Environment stream it comes from.
    #[prost(uint64, tag = "4")]
    pub lane: u64,
    /// Number of the episode within its lane.
    #[prost(uint64, tag = "5")]
    pub episode: u64,
    /// Version of the policy that acted; 0 for an expert.
    #[prost(uint64, tag = "6")]
    pub policy_version: u64,
    /// Seed of the run. With source, lane and episode it names the random streams of the episode.
    #[prost(uint64, tag = "7")]
    pub run_seed: u64,
    /// Number of actions taken.
    #[prost(uint32, tag = "8")]
    pub steps: u32,
    /// Shape of one observation.
    #[prost(uint32, repeated, tag = "9")]
    pub observation_shape: Vec<u32>,
    /// Observations of a grid task; empty otherwise.
    #[prost(bytes = "bytes", tag = "10")]
    pub cells: Bytes,
    /// Observations of a vector task; empty otherwise.
    #[prost(bytes = "bytes", tag = "11")]
    pub values: Bytes,
    /// Actions of a discrete task; empty otherwise.
    #[prost(bytes = "bytes", tag = "12")]
    pub discrete_actions: Bytes,
    /// Actions of a continuous task; empty otherwise.
    #[prost(bytes = "bytes", tag = "13")]
    pub continuous_actions: Bytes,
    /// Log-probability of each action under the policy that acted; empty for an expert.
    #[prost(bytes = "bytes", tag = "14")]
    pub log_probs: Bytes,
    /// The environment's own reward of each step; imitation never reads it.
    #[prost(bytes = "bytes", tag = "15")]
    pub environment_rewards: Bytes,
    /// How the episode ended.
    #[prost(enumeration = "Ending", tag = "16")]
    pub ending: i32,
    /// Whether the goal was reached at some step.
    #[prost(bool, tag = "17")]
    pub success: bool,
    /// Hash of the environment's final state.
    #[prost(fixed64, tag = "18")]
    pub state_hash: u64,
    /// Steps after which the goal was first reached; 0 if it was not.
    #[prost(uint32, tag = "19")]
    pub steps_to_goal: u32,
    /// xxh3 of the encoded trajectory with observations, if they were left out of the log; 0 otherwise.
    #[prost(fixed64, tag = "20")]
    pub full_hash: u64,
}

/// Who produced a trajectory, and what for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, prost::Enumeration)]
#[repr(i32)]
pub enum Source {
    /// The policy, for learning.
    Training = 0,
    /// The policy, on evaluation seeds; never learned from.
    Evaluation = 1,
    /// An expert.
    Demonstration = 2,
}

impl Source {
    /// Returns the purposes of the environment's and the actions' random streams.
    pub fn purposes(self) -> (seed::Purpose, seed::Purpose) {
        match self {
            Source::Training => (seed::Purpose::TrainingEpisode, seed::Purpose::TrainingActions),
            Source::Evaluation => {
                (seed::Purpose::EvaluationEpisode, seed::Purpose::EvaluationActions)
            }
            Source::Demonstration => (seed::Purpose::Demonstration, seed::Purpose::Demonstration),
        }
    }
}

/// Name of a trajectory within a run, and the hash of its content.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Message)]
pub struct TrajectoryKey {
    /// Environment stream.
    #[prost(uint64, tag = "1")]
    pub lane: u64,
    /// Number of the episode within its lane.
    #[prost(uint64, tag = "2")]
    pub episode: u64,
    /// xxh3 of the encoded trajectory.
    #[prost(fixed64, tag = "3")]
    pub hash: u64,
}

/// A trajectory together with its encoded bytes.
#[derive(Clone, Debug, PartialEq)]
pub struct Encoded {
    /// The decoded trajectory; its arrays share `bytes`.
    pub trajectory: Trajectory,
    /// The encoded trajectory.
    pub bytes: Bytes,
    /// Name and hash.
    pub key: TrajectoryKey,
}

impl Encoded {
    /// Decodes `bytes` and checks the trajectory, observations included, against the shapes of its
    /// task.
    ///
    /// # Errors
    /// [`Error::Undecodable`] if the bytes are not a trajectory; [`Error::Trajectory`] if a part does not fit the
    /// task, or observations were left out.
    pub fn decode(bytes: Bytes, spec: &Spec) -> Result<Self, Error> {
        let trajectory = Trajectory::recorded(bytes.clone(), spec)?;
        if trajectory.is_actions_only() {
            let expected = format!("of {} steps", trajectory.steps);
            let found = "actions only; `goalward log restore` adds them";
            return Err(mismatch("observations", expected, found));
        }
        Ok(Self::with_bytes(trajectory, bytes))
    }

    /// Encodes a trajectory.
    pub fn encode(trajectory: Trajectory) -> Self {
        let bytes = Bytes::from(trajectory.encode_to_vec());
        Self::with_bytes(trajectory, bytes)
    }

    fn with_bytes(trajectory: Trajectory, bytes: Bytes) -> Self {
        let hash = xxhash_rust::xxh3::xxh3_64(&bytes);
        let key = TrajectoryKey { lane: trajectory.lane, episode: trajectory.episode, hash };
        Encoded { trajectory, bytes, key }
    }
}

impl Trajectory {
    /// Decodes and checks a trajectory from a log, which may lack observations.
    ///
    /// # Errors
    /// [`Error::Undecodable`] if the bytes are not a trajectory; [`Error::Trajectory`] if a part does not fit the
    /// task.
    pub fn recorded(bytes: Bytes, spec: &Spec) -> Result<Self, Error> {
        let trajectory = Trajectory::decode(bytes)
            .map_err(|source| Error::Undecodable { what: "trajectory", source })?;
        trajectory.check(spec)?;
        Ok(trajectory)
    }

    /// Returns an upper bound on the encoded size of a task's longest episode, with or without observations.
    pub fn most_bytes(spec: &Spec, observations: bool) -> u64 {
        let (steps, observation) = (u64::from(spec.horizon_steps), spec.observation.bytes() as u64);
        let observed = if observations { (steps + 1).saturating_mul(observation) } else { 0 };
        // A log-probability and a reward have four bytes each.
        let acted = steps.saturating_mul(spec.action.bytes() as u64 + 8);
        observed.saturating_add(acted).saturating_add(HEAD_BYTES)
    }

    /// Returns whether observations were left out.
    pub fn is_actions_only(&self) -> bool {
        self.full_hash != 0
    }

    /// Returns the trajectory without observations. `full_hash` is the hash of the encoded trajectory with them.
    pub fn actions_only(self, full_hash: u64) -> Self {
        Trajectory { cells: Bytes::new(), values: Bytes::new(), full_hash, ..self }
    }

    /// Returns all observations, concatenated, each of the spec's length in bytes.
    pub fn observations(&self) -> &[u8] {
        if self.cells.is_empty() { &self.values } else { &self.cells }
    }

    /// Returns the observations up to and including the one at the goal; all of them if the goal was not reached.
    pub fn observations_to_goal(&self) -> &[u8] {
        let all = self.observations();
        let one = all.len() / (self.steps as usize + 1);
        if self.success { &all[..one * (self.steps_to_goal as usize + 1)] } else { all }
    }

    /// Returns all actions, concatenated, each of the spec's length in bytes.
    pub fn actions(&self) -> &[u8] {
        if self.discrete_actions.is_empty() {
            &self.continuous_actions
        } else {
            &self.discrete_actions
        }
    }

    /// Returns the sum of the environment's own rewards.
    pub fn environment_return(&self) -> f64 {
        crate::task::floats(&self.environment_rewards).map(f64::from).sum()
    }

    /// Checks lengths, classes and finiteness against the task's shapes. The task's name is not checked: files and
    /// runs state it as a whole.
    ///
    /// # Errors
    /// [`Error::Trajectory`] for the first part that does not fit.
    pub fn check(&self, spec: &Spec) -> Result<(), Error> {
        let steps = self.steps as usize;
        expect("observation shape", spec.observation.shape(), self.observation_shape.clone())?;
        if steps == 0 || steps > spec.horizon_steps as usize {
            let expected = format!("1 to {}", spec.horizon_steps);
            return Err(mismatch("steps", expected, steps));
        }
        self.check_names()?;
        self.check_goal()?;
        let observed = if self.is_actions_only() { 0 } else { steps + 1 };
        let (cells, values) = match spec.observation {
            ObservationSpec::Cells { .. } => (observed * spec.observation.bytes(), 0),
            ObservationSpec::Vector { .. } => (0, observed * spec.observation.bytes()),
        };
        expect("bytes of cells", cells, self.cells.len())?;
        expect("bytes of values", values, self.values.len())?;
        let (discrete, continuous) = match spec.action {
            ActionSpec::Discrete { .. } => (steps, 0),
            ActionSpec::Continuous { .. } => (0, steps * spec.action.bytes()),
        };
        self.check_actions(discrete, continuous)?;
        self.check_contents(spec)
    }

    /// Checks the lengths of the arrays with one entry per step. Demonstrations may lack actions and rewards.
    fn check_actions(&self, discrete: usize, continuous: usize) -> Result<(), Error> {
        let demonstration = self.source == Source::Demonstration as i32;
        if !(demonstration && self.actions().is_empty()) {
            expect("bytes of discrete actions", discrete, self.discrete_actions.len())?;
            expect("bytes of continuous actions", continuous, self.continuous_actions.len())?;
        }
        let per_step = 4 * self.steps as usize;
        let log_probs = if demonstration { 0 } else { per_step };
        expect("bytes of log-probabilities", log_probs, self.log_probs.len())?;
        if demonstration && self.environment_rewards.is_empty() {
            return Ok(());
        }
        expect("bytes of environment rewards", per_step, self.environment_rewards.len())
    }

    fn check_names(&self) -> Result<(), Error> {
        if Source::try_from(self.source).is_err() {
            return Err(mismatch("source", "0 to 2".to_owned(), self.source));
        }
        if Ending::try_from(self.ending).is_err() {
            return Err(mismatch("ending", "0 to 2".to_owned(), self.ending));
        }
        Ok(())
    }

    /// Checks the steps to the goal. A demonstration ends at the goal and need not say when it reached it.
    fn check_goal(&self) -> Result<(), Error> {
        let reached = if self.success { 1..=self.steps } else { 0..=0 };
        let demonstration = self.source == Source::Demonstration as i32;
        let reached = if demonstration { 0..=self.steps } else { reached };
        if reached.contains(&self.steps_to_goal) {
            return Ok(());
        }
        Err(mismatch("steps to the goal", format!("{reached:?}"), self.steps_to_goal))
    }

    fn check_contents(&self, spec: &Spec) -> Result<(), Error> {
        spec.observation.check(self.observations())?;
        if let ActionSpec::Discrete { count } = spec.action
            && let Some(&action) =
                self.discrete_actions.iter().find(|&&action| usize::from(action) >= count)
        {
            return Err(mismatch("action", format!("below {count}"), action));
        }
        let numbers = [
            ("action", &self.continuous_actions),
            ("log-probability", &self.log_probs),
            ("environment reward", &self.environment_rewards),
        ];
        for (name, bytes) in numbers {
            if let Some(number) = crate::task::floats(bytes).find(|number| !number.is_finite()) {
                return Err(mismatch(name, "finite numbers".to_owned(), number));
            }
        }
        Ok(())
    }
}

fn expect<T: PartialEq + std::fmt::Debug>(
    what: &'static str,
    expected: T,
    found: T,
) -> Result<(), Error> {
    if expected == found {
        return Ok(());
    }
    Err(mismatch(what, format!("{expected:?}"), shortened(&format!("{found:?}"), FOUND_CHARS)))
}

fn mismatch(what: &'static str, expected: String, found: impl ToString) -> Error {
    Error::Trajectory { what, expected, found: found.to_string() }
}
