//! The input of a reward model: a state, a transition, or a state and the action taken there.
//!
//! A row consists of the bytes of its observations, followed by its extra inputs as little-endian `f32`.
//! Demonstrations, experience and everything that is scored are turned into rows only here.

use networks::{Batch, Network, NetworkShape, Observations, RewardArchitecture, WindowIndex};
use protocol::task::{ActionSpec, ObservationSpec, Spec, floats};
use run::config::RewardInput;

/// Layout of a task's rows for a model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Input {
    observation: ObservationSpec,
    action: ActionSpec,
    sees: RewardInput,
}

/// Rows in the form that a network reads.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rows {
    /// The observations of all rows.
    pub observations: Vec<u8>,
    /// The extra inputs of all rows.
    pub extra_inputs: Vec<f32>,
}

impl Rows {
    /// Returns the rows as a batch for a network.
    pub fn batch(&self) -> Batch<'_> {
        let observations = Observations::Bytes(&self.observations);
        Batch { observations, extra_inputs: &self.extra_inputs }
    }

    /// Returns the rows as a batch that several networks with the same encoder evaluate.
    pub fn indexed<'a>(&'a self, network: &Network, windows: &'a mut WindowIndex) -> Batch<'a> {
        let observations = Observations::Indexed(network.index(&self.observations, windows));
        Batch { observations, ..self.batch() }
    }
}

impl Input {
    /// Creates the layout for a task and what the model sees of a step.
    pub fn new(spec: &Spec, sees: RewardInput) -> Self {
        Input { observation: spec.observation, action: spec.action, sees }
    }

    /// Returns what the model sees of a step.
    pub fn sees(&self) -> RewardInput {
        self.sees
    }

    /// Returns the number of observations in a row.
    pub fn frames(&self) -> usize {
        if self.sees == RewardInput::Transition { 2 } else { 1 }
    }

    /// Returns the number of extra inputs in a row. A discrete action is one-hot encoded.
    pub fn extra_inputs(&self) -> usize {
        match (self.sees, self.action) {
            (RewardInput::StateAction, ActionSpec::Discrete { count }) => count,
            (RewardInput::StateAction, ActionSpec::Continuous { len }) => len,
            _ => 0,
        }
    }

    /// Returns the shape of a network over these rows.
    pub fn network_shape(&self, architecture: &RewardArchitecture) -> NetworkShape {
        architecture.network_shape(self.observation, self.frames(), self.extra_inputs())
    }

    fn observation_bytes(&self) -> usize {
        self.frames() * self.observation.bytes()
    }

    /// Returns the length of a row in bytes.
    pub fn row_bytes(&self) -> usize {
        self.observation_bytes() + 4 * self.extra_inputs()
    }

    /// Appends a row for every step of an episode. Its first observation is the one in which the step acts, or the one
    /// it reaches if the model sees next states.
    pub fn append_steps(&self, observations: &[u8], actions: &[u8], rows: &mut Vec<u8>) {
        let (one, seen) = (self.observation.bytes(), self.observation_bytes());
        let ahead = usize::from(self.sees == RewardInput::NextState);
        for step in 0..observations.len() / one - 1 {
            let first = (step + ahead) * one;
            rows.extend(&observations[first..first + seen]);
            if self.sees == RewardInput::StateAction {
                let width = self.action.bytes();
                self.append_action(&actions[step * width..(step + 1) * width], rows);
            }
        }
    }

    /// Returns the number of rows that [`Input::append_places`] appends for an episode of `steps` steps.
    pub fn places(&self, steps: usize) -> usize {
        if self.sees == RewardInput::StateAction { steps } else { steps + 1 }
    }

    /// Appends rows that show how far an episode has come: its observations or, if the model sees actions, its
    /// steps, each of which stands for the observation it leads to.
    ///
    /// # Panics
    /// If the model sees transitions, since none begins at the last observation, or next states, since none is
    /// the first.
    pub fn append_places(&self, observations: &[u8], actions: &[u8], rows: &mut Vec<u8>) {
        let fits = matches!(self.sees, RewardInput::State | RewardInput::StateAction);
        assert!(fits, "a place is an observation or a step, not a {:?}", self.sees);
        self.append_steps(observations, actions, rows);
        if self.sees == RewardInput::State {
            rows.extend(&observations[observations.len() - self.observation.bytes()..]);
        }
    }

    /// Appends a row for every observation of an episode. If the model sees actions, no step leads to the first
    /// observation. It then gets the row of the second one, so that the first step makes no difference.
    ///
    /// # Panics
    /// As [`Input::append_places`].
    pub fn append_observations(&self, observations: &[u8], actions: &[u8], rows: &mut Vec<u8>) {
        let first = rows.len();
        self.append_places(observations, actions, rows);
        if self.sees == RewardInput::StateAction {
            let row = rows[first..first + self.row_bytes()].to_vec();
            rows.splice(first..first, row);
        }
    }

    fn append_action(&self, action: &[u8], rows: &mut Vec<u8>) {
        match self.action {
            ActionSpec::Continuous { .. } => rows.extend(action),
            ActionSpec::Discrete { count } => {
                let taken = usize::from(action[0]);
                let number = |choice| if choice == taken { 1.0_f32 } else { 0.0 };
                rows.extend((0..count).flat_map(|choice| number(choice).to_le_bytes()));
            }
        }
    }

    /// Splits rows into observations and extra inputs for a network.
    pub fn split(&self, rows: Vec<u8>) -> Rows {
        if self.extra_inputs() == 0 {
            return Rows { observations: rows, extra_inputs: Vec::new() };
        }
        let mut split = Rows::default();
        for row in rows.chunks_exact(self.row_bytes()) {
            let (observations, extra_inputs) = row.split_at(self.observation_bytes());
            split.observations.extend(observations);
            split.extra_inputs.extend(floats(extra_inputs));
        }
        split
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TINY: Spec = Spec {
        observation: ObservationSpec::Cells { height: 1, width: 2, classes: 9 },
        action: ActionSpec::Discrete { count: 2 },
        horizon_steps: 9,
    };

    #[test]
    fn rows_hold_what_the_model_sees() {
        let (observations, actions) = ([1, 2, 3, 4, 5, 6], [1, 0]);
        let steps = |sees| {
            let (input, mut rows) = (Input::new(&TINY, sees), Vec::new());
            input.append_steps(&observations, &actions, &mut rows);
            assert_eq!(rows.len(), 2 * input.row_bytes());
            input.split(rows)
        };
        assert_eq!(steps(RewardInput::State).observations, [1, 2, 3, 4]);
        assert_eq!(steps(RewardInput::NextState).observations, [3, 4, 5, 6]);
        assert_eq!(steps(RewardInput::Transition).observations, [1, 2, 3, 4, 3, 4, 5, 6]);
        let found = steps(RewardInput::StateAction);
        assert_eq!(found.observations, [1, 2, 3, 4]);
        assert_eq!(found.extra_inputs, [0.0, 1.0, 1.0, 0.0]);
    }

    #[test]
    fn an_action_stands_for_the_observation_it_leads_to() {
        let (observations, actions) = ([1, 2, 3, 4, 5, 6], [1, 0]);
        let input = Input::new(&TINY, RewardInput::StateAction);
        let (mut places, mut scored) = (Vec::new(), Vec::new());
        input.append_places(&observations, &actions, &mut places);
        input.append_observations(&observations, &actions, &mut scored);
        assert_eq!(places.len(), input.places(2) * input.row_bytes());
        let [places, scored] = [places, scored].map(|rows| input.split(rows));
        assert_eq!(places.observations, [1, 2, 3, 4]);
        assert_eq!(places.extra_inputs, [0.0, 1.0, 1.0, 0.0]);
        assert_eq!(scored.observations, [1, 2, 1, 2, 3, 4]);
        assert_eq!(scored.extra_inputs, [0.0, 1.0, 0.0, 1.0, 1.0, 0.0]);
    }
}
