//! The newest agent observations, negative examples of the online update (Eq. 4).

use std::collections::VecDeque;

use protocol::trajectory::Trajectory;

/// A first-in, first-out buffer of observations of one length.
#[derive(Clone, Debug, PartialEq)]
pub struct Experience {
    bytes: VecDeque<u8>,
    observation_bytes: usize,
    capacity: usize,
}

impl Experience {
    /// An empty buffer for `capacity` observations of `observation_bytes` each.
    pub fn new(capacity: usize, observation_bytes: usize) -> Experience {
        let bytes = VecDeque::with_capacity(capacity * observation_bytes);
        Experience { bytes, observation_bytes, capacity }
    }

    /// Observations held.
    pub fn len(&self) -> usize {
        self.bytes.len() / self.observation_bytes
    }

    /// Whether none is held.
    pub fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    /// Takes in the observations of an episode up to the goal; the oldest make room.
    pub fn push(&mut self, trajectory: &Trajectory) {
        self.push_bytes(trajectory.observations_to_goal());
    }

    /// Takes in observations, one after another.
    pub fn push_bytes(&mut self, observations: &[u8]) {
        assert_eq!(observations.len() % self.observation_bytes, 0, "whole observations");
        self.bytes.extend(observations);
        let room = self.capacity * self.observation_bytes;
        let excess = self.bytes.len().saturating_sub(room);
        self.bytes.drain(..excess);
    }

    /// The observation at `position`, 0 being the oldest, appended to `row`.
    pub fn append_to(&self, position: usize, row: &mut Vec<u8>) {
        let start = position * self.observation_bytes;
        row.extend(self.bytes.range(start..start + self.observation_bytes));
    }

    /// Every observation, oldest first.
    pub fn to_bytes(&self) -> Vec<u8> {
        self.bytes.iter().copied().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_oldest_observations_make_room() {
        let mut experience = Experience::new(3, 2);
        experience.push_bytes(&[1, 1, 2, 2]);
        experience.push_bytes(&[3, 3, 4, 4]);
        assert_eq!(experience.to_bytes(), [2, 2, 3, 3, 4, 4]);
        let mut row = Vec::new();
        experience.append_to(1, &mut row);
        assert_eq!((experience.len(), row), (3, vec![3, 3]));
    }
}
