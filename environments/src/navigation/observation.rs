//! The agent's observation: the whole grid, one class per cell.

use super::class::{AGENT, GOAL};
use super::rooms::{CELL_COUNT, Cell, Rooms};

/// Writes the classes of the 19 x 19 cells row by row. The agent hides the goal when it stands on it.
///
/// # Panics
/// When `observation` is not exactly 361 bytes long.
pub(super) fn write(rooms: &Rooms, agent: Cell, goal: Cell, observation: &mut [u8]) {
    assert_eq!(observation.len(), CELL_COUNT, "the caller sizes the observation by the spec");
    observation.copy_from_slice(&rooms.classes);
    observation[goal.index()] = GOAL;
    observation[agent.index()] = AGENT;
}
