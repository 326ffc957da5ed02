//! Transitions that are sampled repeatedly: the newest of the agent, or those of demonstrations.

use std::collections::VecDeque;

use protocol::ending::Ending;
use protocol::task::Spec;
use protocol::trajectory::Trajectory;

/// A first-in, first-out buffer of transitions. Episodes share the bytes they arrived in.
pub(crate) struct ReplayBuffer {
    spec: Spec,
    capacity: usize,
    episodes: VecDeque<Trajectory>,
    /// Number of the first episode held.
    first_episode: u64,
    /// Episode and step of each transition, the oldest first.
    transitions: VecDeque<(u64, u32)>,
    /// Number of transitions added so far.
    steps: u64,
}

/// A transition.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Transition<'a> {
    /// The observation acted on and the next one, concatenated.
    pub(crate) observations: &'a [u8],
    /// The action taken.
    pub(crate) action: &'a [u8],
    /// How the task ended the episode here; `None` if the episode went on, or was cut off by the horizon.
    pub(crate) ending: Option<Ending>,
}

impl ReplayBuffer {
    /// Creates an empty buffer for `capacity` transitions of a task.
    pub(crate) fn new(spec: Spec, capacity: usize) -> ReplayBuffer {
        let (episodes, transitions) = (VecDeque::new(), VecDeque::new());
        ReplayBuffer { spec, capacity, episodes, first_episode: 0, transitions, steps: 0 }
    }

    /// Creates a buffer of all transitions of demonstrations.
    pub(crate) fn of_demonstrations(spec: Spec, demonstrations: &[Trajectory]) -> ReplayBuffer {
        let mut buffer = ReplayBuffer::new(spec, usize::MAX);
        demonstrations.iter().for_each(|demonstration| buffer.push(demonstration));
        buffer
    }

    /// Adds an episode; the oldest transitions make room for it.
    pub(crate) fn push(&mut self, trajectory: &Trajectory) {
        let number = self.first_episode + self.episodes.len() as u64;
        self.steps += u64::from(trajectory.steps);
        self.episodes.push_back(trajectory.clone());
        self.transitions.extend((0..trajectory.steps).map(|step| (number, step)));
        let excess = self.transitions.len().saturating_sub(self.capacity);
        self.transitions.drain(..excess);
        let oldest = self.transitions.front().map_or(self.first_episode, |(number, _)| *number);
        self.episodes.drain(..(oldest - self.first_episode) as usize);
        self.first_episode = oldest;
    }

    /// Returns the number of transitions added so far, including those that were dropped since.
    pub(crate) fn steps(&self) -> u64 {
        self.steps
    }

    /// Returns the number of transitions held.
    pub(crate) fn len(&self) -> usize {
        self.transitions.len()
    }

    /// Returns the transition at `position`; 0 is the oldest.
    pub(crate) fn get(&self, position: usize) -> Transition<'_> {
        let (number, step) = self.transitions[position];
        let trajectory = &self.episodes[(number - self.first_episode) as usize];
        let (one, action) = (self.spec.observation.bytes(), self.spec.action.bytes());
        let step = step as usize;
        let last = step + 1 == trajectory.steps as usize;
        let ending = Ending::try_from(trajectory.ending).ok();
        Transition {
            observations: &trajectory.observations()[step * one..(step + 2) * one],
            action: trajectory.actions().get(step * action..(step + 1) * action).unwrap_or(&[]),
            ending: ending.filter(|ending| last && *ending != Ending::Truncated),
        }
    }
}

#[cfg(test)]
mod tests {
    use protocol::task::{ActionSpec, ObservationSpec};

    use super::*;

    fn episode(first: u8, steps: u32) -> Trajectory {
        let mut cells = vec![0; 361 * (steps as usize + 1)];
        for (step, observation) in (first..).zip(cells.chunks_exact_mut(361)) {
            observation[0] = step;
        }
        Trajectory {
            steps,
            cells: cells.into(),
            discrete_actions: (first..).take(steps as usize).collect::<Vec<u8>>().into(),
            ending: Ending::GoalReached as i32,
            ..Trajectory::default()
        }
    }

    #[test]
    fn the_newest_transitions_stay_and_keep_their_episodes() {
        let spec = Spec {
            observation: ObservationSpec::Cells { height: 19, width: 19, classes: 4 },
            action: ActionSpec::Discrete { count: 4 },
            horizon_steps: 100,
        };
        let mut buffer = ReplayBuffer::new(spec, 4);
        buffer.push(&episode(10, 3));
        buffer.push(&episode(20, 3));
        assert_eq!((buffer.len(), buffer.episodes.len()), (4, 2));
        let found: Vec<_> = (0..4)
            .map(|position| {
                let transition = buffer.get(position);
                let observations = transition.observations;
                (observations[0], observations[361], transition.action[0], transition.ending)
            })
            .collect();
        let goal = Some(Ending::GoalReached);
        assert_eq!(
            found,
            [(12, 13, 12, goal), (20, 21, 20, None), (21, 22, 21, None), (22, 23, 22, goal)]
        );
        let failed = Trajectory { ending: Ending::Failed as i32, ..episode(40, 1) };
        let cut_off = Trajectory { ending: Ending::Truncated as i32, ..episode(41, 1) };
        for (other, ending) in [(failed, Some(Ending::Failed)), (cut_off, None)] {
            buffer.push(&other);
            assert_eq!(buffer.get(3).ending, ending);
        }
        buffer.push(&episode(30, 4));
        assert_eq!((buffer.len(), buffer.episodes.len(), buffer.get(0).action[0]), (4, 1, 30));
    }
}
