//! Navigation: the agent walks through four rooms to a goal (paper, Section 4.3 and Table 1).
//!
//! Doors, start and goal are drawn for every episode. The start is drawn uniformly from the room cells that the
//! [`NavigationSetting`] keeps, the goal uniformly from the other kept cells. Neither is ever in a door.
//!
//! # Action
//! One byte. A move against a wall leaves the agent where it is but still counts as a step.
//!
//! | action | meaning | the agent moves to |
//! |---|---|---|
//! | 0 | right | (x + 1, y) |
//! | 1 | down | (x, y + 1) |
//! | 2 | left | (x - 1, y) |
//! | 3 | up | (x, y - 1) |
//!
//! # Observation
//! 361 bytes, one class per cell; networks see four one-hot channels in the order of the classes.
//!
//! | index | meaning | range |
//! |---|---|---|
//! | 19 y + x | class of the cell in column x, row y, both 0 to 18 from the upper left | 0 to 3 |
//!
//! | class | meaning | number of cells |
//! |---|---|---|
//! | 0 [`EMPTY`] | free, doors included | 258; 259 when the agent is at the goal |
//! | 1 [`WALL`] | wall | 101 |
//! | 2 [`GOAL`] | goal | 1; 0 when the agent is at the goal |
//! | 3 [`AGENT`] | agent | 1 |
//!
//! # Ending, success and reward
//! Entering the goal is a success and terminates the episode, unless [`end_at_goal`](NavigationSetting::end_at_goal)
//! is off; otherwise the episode is truncated at step 100. The environment's own reward is `1 - 0.9 t / 100` for the
//! step `t` that first enters the goal, and 0 for every other step.

mod class;
mod expert;
mod observation;
mod rooms;
mod universe;

pub use class::{AGENT, EMPTY, GOAL, WALL};

use crate::{Environment, EnvironmentError, Setting, Step, action};
use expert::Distances;
use protocol::seed::Stream;
use protocol::task::{ActionSpec, ObservationSpec, Spec};
use rand::RngExt;
use rooms::{CELL_COUNT, Cell, Rooms, SIZE};
use serde::{Deserialize, Serialize};
use xxhash_rust::xxh3::xxh3_64;

/// The shapes of the task.
pub const SPEC: Spec = Spec {
    observation: ObservationSpec::Cells { height: SIZE, width: SIZE, classes: 4 },
    action: ActionSpec::Discrete { count: 4 },
    horizon_steps: 100,
};

/// The setting of Navigation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NavigationSetting {
    /// Fraction of the room cells that starts and goals are drawn from, above 0 and at most 1. The paper uses 0.25,
    /// 0.5, 0.75 and 1.
    pub coverage: f64,
    /// Whether reaching the goal ends an episode. Otherwise it goes on to the horizon, as with a robot that cannot
    /// detect its arrival.
    pub end_at_goal: bool,
}

impl Default for NavigationSetting {
    fn default() -> Self {
        NavigationSetting { coverage: 1.0, end_at_goal: true }
    }
}

/// The environment of the task `navigation`.
#[derive(Clone, Debug)]
pub struct Navigation {
    setting: NavigationSetting,
    /// Cells that starts and goals are drawn from.
    universe: &'static [Cell],
    /// Walls and doors of the current episode.
    rooms: Rooms,
    agent: Cell,
    goal: Cell,
    /// Number of steps taken in the episode.
    steps: u32,
    /// Whether an episode has begun and not ended.
    running: bool,
    /// Whether the goal has been reached in the episode.
    success: bool,
    /// The expert's distances, once it has been asked in this episode.
    distances: Option<Distances>,
}

impl Navigation {
    /// Builds the environment; its first episode begins with a reset.
    ///
    /// # Errors
    /// When the coverage is not above 0 and at most 1, or keeps fewer than two cells.
    pub fn new(setting: NavigationSetting) -> Result<Navigation, EnvironmentError> {
        let universe = universe::universe(setting.coverage)?;
        Ok(Navigation {
            setting,
            universe,
            rooms: Rooms::SHUT,
            agent: universe[0],
            goal: universe[1],
            steps: 0,
            running: false,
            success: false,
            distances: None,
        })
    }

    /// Draws a start and, from the other kept cells, a goal.
    fn draw_start_and_goal(&self, stream: &mut Stream) -> (Cell, Cell) {
        let count = self.universe.len() as u32;
        let start = stream.random_range(0..count);
        let among_others = stream.random_range(0..count - 1);
        let goal = among_others + u32::from(among_others >= start);
        (self.universe[start as usize], self.universe[goal as usize])
    }
}

impl Environment for Navigation {
    fn spec(&self) -> Spec {
        SPEC
    }

    fn setting(&self) -> Setting {
        Setting::of(&self.setting)
    }

    fn reset(
        &mut self,
        stream: &mut Stream,
        observation: &mut [u8],
    ) -> Result<(), EnvironmentError> {
        self.rooms = Rooms::draw(stream);
        (self.agent, self.goal) = self.draw_start_and_goal(stream);
        self.steps = 0;
        self.running = true;
        self.success = false;
        self.distances = None;
        observation::write(&self.rooms, self.agent, self.goal, observation);
        Ok(())
    }

    fn step(&mut self, action: &[u8], observation: &mut [u8]) -> Result<Step, EnvironmentError> {
        let spec = self.spec();
        action::check_action(&spec, self.running, action)?;
        let target = self.agent.neighbor(usize::from(action[0]));
        if self.rooms.is_free(target) {
            self.agent = target;
        }
        self.steps += 1;
        observation::write(&self.rooms, self.agent, self.goal, observation);

        let arrives = self.agent == self.goal && !self.success;
        self.success |= arrives;
        let ending = spec.ending(arrives && self.setting.end_at_goal, self.steps);
        self.running = ending.is_none();
        let reward =
            if arrives { 1.0 - 0.9 * self.steps as f32 / spec.horizon_steps as f32 } else { 0.0 };
        Ok(Step { reward, ending, success: self.success })
    }

    fn expert_action(&mut self, action: &mut [u8]) -> Result<bool, EnvironmentError> {
        assert_eq!(action.len(), self.spec().action.bytes(), "the caller sizes the action");
        if !self.running {
            return Ok(false);
        }
        let (rooms, goal) = (&self.rooms, self.goal);
        let distances = self.distances.get_or_insert_with(|| Distances::search(rooms, goal));
        let toward_goal = distances.first_move(self.agent);
        if let Some(toward_goal) = toward_goal {
            action[0] = toward_goal;
        }
        Ok(toward_goal.is_some())
    }

    fn state_hash(&self) -> u64 {
        let mut state = [0; CELL_COUNT + 9];
        let (classes, rest) = state.split_at_mut(CELL_COUNT);
        classes.copy_from_slice(&self.rooms.classes);
        rest[0..2].copy_from_slice(&(self.agent.index() as u16).to_le_bytes());
        rest[2..4].copy_from_slice(&(self.goal.index() as u16).to_le_bytes());
        rest[4..8].copy_from_slice(&self.steps.to_le_bytes());
        // 2 where the goal was reached and the episode goes on.
        rest[8] = u8::from(self.running) + u8::from(self.running && self.success);
        xxh3_64(&state)
    }
}
