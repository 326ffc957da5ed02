//! What the agent sees: the whole grid as one class a cell.

use super::rooms::{CELL_COUNT, Cell, Rooms};

/// Class of a free cell, doors included.
pub const EMPTY: u8 = 0;
/// Class of a wall.
pub const WALL: u8 = 1;
/// Class of the goal, as long as the agent does not stand on it.
pub const GOAL: u8 = 2;
/// Class of the cell the agent stands on, the goal included.
pub const AGENT: u8 = 3;

/// Writes the classes of the 19 x 19 cells row by row. The agent hides the goal it stands on.
///
/// # Panics
/// When `observation` is not exactly 361 bytes long.
pub(super) fn write(rooms: &Rooms, agent: Cell, goal: Cell, observation: &mut [u8]) {
    assert_eq!(observation.len(), CELL_COUNT, "the caller sizes the observation by the spec");
    observation.copy_from_slice(&rooms.classes);
    observation[goal.index()] = GOAL;
    observation[agent.index()] = AGENT;
}
