//! The classes of cells, as observations name them.

/// Class of a free cell, doors included.
pub const EMPTY: u8 = 0;
/// Class of a wall.
pub const WALL: u8 = 1;
/// Class of the goal, as long as the agent does not stand on it.
pub const GOAL: u8 = 2;
/// Class of the cell the agent stands on, the goal included.
pub const AGENT: u8 = 3;
