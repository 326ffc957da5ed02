//! How large the networks of a configuration are, counted from shapes alone as the crate `networks`
//! lays them out; a test there compares.

use protocol::task::{ActionSpec, ObservationSpec};

use super::{RewardInput, RunConfig};

/// Side of a convolution's window.
const KERNEL: usize = 2;

/// Side of the squares pooled behind the first convolution.
const POOL: usize = 2;

/// The size of a network. Floating-point numbers are exact here up to 2^53, and what somebody mistyped
/// does not overflow them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NetworkSize {
    /// Parameters.
    pub parameters: f64,
    /// Numbers that one row makes in all of its layers.
    pub row_numbers: f64,
}

impl NetworkSize {
    /// A layer of so many sums, each of which is a number of a row at `positions` places.
    fn add(&mut self, inputs: f64, sums: f64, positions: f64) {
        self.parameters += (inputs + 1.0) * sums;
        self.row_numbers += sums * positions;
    }

    fn and(self, other: NetworkSize) -> NetworkSize {
        NetworkSize {
            parameters: self.parameters + other.parameters,
            row_numbers: self.row_numbers + other.row_numbers,
        }
    }
}

/// What decides the size of a network.
struct Shape<'a> {
    observation: ObservationSpec,
    frames: usize,
    beside: usize,
    channels: &'a [usize],
    features: usize,
    hidden: &'a [usize],
    outputs: usize,
}

impl Shape<'_> {
    fn size(&self) -> NetworkSize {
        let mut size = NetworkSize::default();
        let mut width = match self.observation {
            ObservationSpec::Vector { len } => (self.frames * len) as f64,
            ObservationSpec::Cells { height, width, classes } => {
                let mut image = [height, width].map(|side| (side + 1 - KERNEL) / POOL);
                let mut inputs = (self.frames * classes) as f64;
                for (layer, &channels) in self.channels.iter().enumerate() {
                    if layer > 0 {
                        image = image.map(|side| side + 1 - KERNEL);
                    }
                    let positions = (image[0] * image[1]) as f64;
                    size.add((KERNEL * KERNEL) as f64 * inputs, channels as f64, positions);
                    inputs = channels as f64;
                }
                size.add((image[0] * image[1]) as f64 * inputs, self.features as f64, 1.0);
                self.features as f64
            }
        };
        width += self.beside as f64;
        size.row_numbers += width;
        for &outputs in self.hidden.iter().chain([&self.outputs]) {
            size.add(width, outputs as f64, 1.0);
            width = outputs as f64;
        }
        size
    }
}

/// Numbers that an action is described by: one for each choice, or for each number.
fn action_numbers(action: ActionSpec) -> usize {
    match action {
        ActionSpec::Discrete { count } => count,
        ActionSpec::Continuous { len } => len,
    }
}

impl RunConfig {
    /// The policy with its value function.
    pub fn policy_size(&self) -> NetworkSize {
        let policy = &self.policy;
        let features = (&policy.convolution_channels[..], policy.features, &policy.hidden[..]);
        self.actor_critic_size(features, 1, policy.shared_trunk, policy.is_squashed())
    }

    /// The inverse dynamics model, of a learner that has one.
    pub fn inverse_dynamics_size(&self) -> Option<NetworkSize> {
        let inverse =
            self.inverse_dynamics.as_ref().filter(|_| self.learner_reads("inverse_dynamics"))?;
        let features = (&inverse.convolution_channels[..], inverse.features, &inverse.hidden[..]);
        Some(self.actor_critic_size(features, 2, true, false))
    }

    fn learner_reads(&self, table: &str) -> bool {
        self.learner.tables().contains(&table)
    }

    fn actor_critic_size(
        &self,
        (channels, features, hidden): (&[usize], usize, &[usize]),
        frames: usize,
        shared: bool,
        squashed: bool,
    ) -> NetworkSize {
        let spec = self.task.spec();
        let cells = matches!(spec.observation, ObservationSpec::Cells { .. });
        let continuous = matches!(spec.action, ActionSpec::Continuous { .. });
        let numbers = action_numbers(spec.action);
        let network = |outputs| {
            let hidden = if cells { &[] } else { hidden };
            let observation = spec.observation;
            Shape { observation, frames, beside: 0, channels, features, hidden, outputs }.size()
        };
        let actor = if continuous && squashed { 2 * numbers } else { numbers };
        let mut size = match cells && shared {
            true => network(actor + 1),
            false => network(actor).and(network(1)),
        };
        // Logarithms of deviations that do not depend on the observation.
        size.parameters += if continuous && !squashed { numbers as f64 } else { 0.0 };
        size
    }

    /// One member of the reward model's ensemble.
    pub fn member_size(&self) -> NetworkSize {
        let (spec, reward) = (self.task.spec(), &self.reward);
        let [frames, beside] = self.reward_row();
        let (observation, channels) = (spec.observation, &reward.convolution_channels);
        let (features, hidden, outputs) = (reward.features, &reward.hidden, 1);
        Shape { observation, frames, beside, channels, features, hidden, outputs }.size()
    }

    /// Observations of a row of the reward model, and numbers beside them.
    pub(super) fn reward_row(&self) -> [usize; 2] {
        match self.reward.input {
            RewardInput::State => [1, 0],
            RewardInput::Transition => [2, 0],
            RewardInput::StateAction => [1, action_numbers(self.task.spec().action)],
        }
    }

    /// One of the two Q-functions, of a learner that has them: with discrete actions the policy is one.
    pub fn q_function_size(&self) -> Option<NetworkSize> {
        let spec = self.task.spec();
        let sqil = self.sqil.as_ref().filter(|_| self.learner_reads("sqil"))?;
        let ActionSpec::Continuous { len: beside } = spec.action else { return None };
        let (observation, hidden) = (spec.observation, &sqil.hidden);
        let (frames, channels, features, outputs) = (1, &[], 0, 1);
        Some(Shape { observation, frames, beside, channels, features, hidden, outputs }.size())
    }
}
