//! The classes of cells in observations.

/// Class of a free cell, doors included.
pub const EMPTY: u8 = 0;
/// Class of a wall.
pub const WALL: u8 = 1;
/// Class of the goal while the agent is not on it.
pub const GOAL: u8 = 2;
/// Class of the cell with the agent, even on the goal.
pub const AGENT: u8 = 3;
