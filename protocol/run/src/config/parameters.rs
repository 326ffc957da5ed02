//! The sizes of a configuration's networks, counted from shapes alone as the crate `networks` lays them out.
//! `learner/tests/sizes.rs` and `proximity-service/src/model/ensemble.rs` compare both.

use protocol::encoder::CellsArchitecture;
use protocol::task::{ActionSpec, ObservationSpec};

use super::{RewardInput, RunConfig};

/// Why there is an image after each convolution.
const ENCODER_FITS: &str = "a configuration is refused whose encoder does not fit its grids";

/// The size of a network, in floating-point numbers: these are exact up to 2^53, and mistyped
/// values do not overflow them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NetworkSize {
    /// Number of parameters.
    pub parameters: f64,
    /// Numbers that one row takes in all layers.
    pub row_numbers: f64,
}

impl NetworkSize {
    /// Adds a layer of `sums` outputs, each computed at `positions` positions of a row.
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

/// What determines the size of a network.
struct Shape<'a> {
    observation: ObservationSpec,
    frames: usize,
    extra_inputs: usize,
    encoder: CellsArchitecture,
    hidden: &'a [usize],
    outputs: usize,
}

impl Shape<'_> {
    fn size(&self) -> NetworkSize {
        let mut size = NetworkSize::default();
        let mut width = match self.observation {
            ObservationSpec::Vector { len } => (self.frames * len) as f64,
            ObservationSpec::Cells { height, width, classes } => {
                let CellsArchitecture { channels, kernel, features, .. } = &self.encoder;
                let images = self.encoder.images([height, width]).expect(ENCODER_FITS);
                let mut inputs = (self.frames * classes) as f64;
                let mut pixels = 0.0;
                for (image, &channels) in images.into_iter().zip(channels) {
                    pixels = (image[0] * image[1]) as f64;
                    size.add((kernel * kernel) as f64 * inputs, channels as f64, pixels);
                    inputs = channels as f64;
                }
                size.add(pixels * inputs, *features as f64, 1.0);
                *features as f64
            }
        };
        width += self.extra_inputs as f64;
        size.row_numbers += width;
        for &outputs in self.hidden.iter().chain([&self.outputs]) {
            size.add(width, outputs as f64, 1.0);
            width = outputs as f64;
        }
        size
    }
}

/// Returns how many numbers describe an action: one for each choice, or one for each dimension.
fn action_numbers(action: ActionSpec) -> usize {
    match action {
        ActionSpec::Discrete { count } => count,
        ActionSpec::Continuous { len } => len,
    }
}

impl RunConfig {
    /// Returns the size of the policy with its value function.
    pub fn policy_size(&self) -> NetworkSize {
        let policy = &self.policy;
        let layers = (policy.encoder(), &policy.hidden[..]);
        self.actor_critic_size(layers, 1, policy.shared_trunk, policy.is_squashed())
    }

    /// Returns the size of the inverse dynamics model, if the learner has one.
    pub fn inverse_dynamics_size(&self) -> Option<NetworkSize> {
        let inverse =
            self.inverse_dynamics.as_ref().filter(|_| self.learner_reads("inverse_dynamics"))?;
        Some(self.actor_critic_size((inverse.encoder(), &inverse.hidden), 2, true, false))
    }

    fn learner_reads(&self, table: &str) -> bool {
        self.learner.tables().contains(&table)
    }

    fn actor_critic_size(
        &self,
        (encoder, hidden): (CellsArchitecture, &[usize]),
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
            let encoder = encoder.clone();
            Shape { observation, frames, extra_inputs: 0, encoder, hidden, outputs }.size()
        };
        let actor = if continuous && squashed { 2 * numbers } else { numbers };
        let mut size = match cells && shared {
            true => network(actor + 1),
            false => network(actor).and(network(1)),
        };
        // Logarithms of standard deviations that do not depend on the observation.
        size.parameters += if continuous && !squashed { numbers as f64 } else { 0.0 };
        size
    }

    /// Returns the size of one member of the ensemble, for a reward model that trains one.
    pub fn member_size(&self) -> NetworkSize {
        let (spec, reward) = (self.task.spec(), &self.reward);
        let [frames, extra_inputs] = self.reward_row();
        let (observation, encoder) = (spec.observation, reward.encoder());
        let (hidden, outputs) = (&reward.hidden, 1);
        Shape { observation, frames, extra_inputs, encoder, hidden, outputs }.size()
    }

    /// Returns the number of observations and of extra inputs in a row of the reward model.
    pub(super) fn reward_row(&self) -> [usize; 2] {
        match self.reward.input {
            RewardInput::State | RewardInput::NextState => [1, 0],
            RewardInput::Transition => [2, 0],
            RewardInput::StateAction => [1, action_numbers(self.task.spec().action)],
        }
    }

    /// Returns the size of one of the two Q-functions, if the learner has them: with discrete
    /// actions the policy itself is the Q-function.
    pub fn q_function_size(&self) -> Option<NetworkSize> {
        let spec = self.task.spec();
        let sqil = self.sqil.as_ref().filter(|_| self.learner_reads("sqil"))?;
        let ActionSpec::Continuous { len: extra_inputs } = spec.action else { return None };
        let (observation, hidden) = (spec.observation, &sqil.hidden);
        let (frames, encoder, outputs) = (1, self.policy.encoder(), 1);
        Some(Shape { observation, frames, extra_inputs, encoder, hidden, outputs }.size())
    }
}
