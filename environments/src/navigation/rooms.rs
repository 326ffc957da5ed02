//! The four rooms: fixed walls, and doors that are drawn for every episode.
//!
//! The grid is 19 x 19; `x` grows to the right and `y` downward. The outer wall and the two inner walls are where `x`
//! or `y` is 0, 9 or 18, which leaves four rooms of 8 x 8 cells. Each of the four inner wall segments between two
//! rooms has a door of one cell. The rooms thus form a ring, and every cell can be reached from every other.

use super::class::{EMPTY, WALL};
use protocol::seed::Stream;
use rand::RngExt;

/// Number of rows, and of columns, of the grid.
pub(super) const SIZE: usize = 19;

/// Number of cells of the grid, walls included.
pub(super) const CELL_COUNT: usize = SIZE * SIZE;

/// Number of moves; move 0 goes to +x, 1 to +y, 2 to -x and 3 to -y.
pub(super) const MOVE_COUNT: usize = 4;

/// Distance between two walls, and thus the coordinate of the inner walls.
const WALL_STEP: usize = 9;

/// Number of free cells along one side of a room.
const ROOM_SIZE: usize = WALL_STEP - 1;

/// One cell, given by its index in the observation: `19 y + x`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Cell(u16);

impl Cell {
    /// Returns the cell at column `x` and row `y`.
    pub(super) const fn at(x: usize, y: usize) -> Cell {
        assert!(x < SIZE && y < SIZE, "a cell lies on the grid");
        Cell((SIZE * y + x) as u16)
    }

    /// Returns the index of the cell in the observation.
    pub(super) fn index(self) -> usize {
        usize::from(self.0)
    }

    /// Returns the cell that a move leads to. A free cell is never at the edge of the grid, because of the outer wall,
    /// so a move from it stays on the grid.
    pub(super) fn neighbor(self, direction: usize) -> Cell {
        const OFFSETS: [i16; MOVE_COUNT] = [1, SIZE as i16, -1, -(SIZE as i16)];
        Cell(self.0.wrapping_add_signed(OFFSETS[direction]))
    }
}

/// The positions of the four doors, each from 0 to 7 along its wall segment.
#[derive(Clone, Copy, Debug)]
pub(super) struct Doors {
    /// Row of the door in the upper half of the vertical wall.
    pub(super) upper: usize,
    /// Row of the door in the lower half of the vertical wall.
    pub(super) lower: usize,
    /// Column of the door in the left half of the horizontal wall.
    pub(super) left: usize,
    /// Column of the door in the right half of the horizontal wall.
    pub(super) right: usize,
}

/// The rooms of one episode.
#[derive(Clone, Debug)]
pub(super) struct Rooms {
    /// The class of each cell, `EMPTY` or `WALL`, row by row, without agent and goal.
    pub(super) classes: [u8; CELL_COUNT],
}

impl Rooms {
    /// The rooms with all doors shut, as before the first episode.
    pub(super) const SHUT: Rooms = Rooms { classes: walls() };

    /// Returns rooms with uniformly drawn doors.
    pub(super) fn draw(stream: &mut Stream) -> Rooms {
        let mut door = || stream.random_range(0..ROOM_SIZE as u32) as usize;
        Rooms::with(Doors { upper: door(), lower: door(), left: door(), right: door() })
    }

    /// Returns rooms with the given doors.
    pub(super) fn with(doors: Doors) -> Rooms {
        let (near, far) = (1, WALL_STEP + 1);
        let mut rooms = Rooms::SHUT;
        for door in [
            Cell::at(WALL_STEP, near + doors.upper),
            Cell::at(WALL_STEP, far + doors.lower),
            Cell::at(near + doors.left, WALL_STEP),
            Cell::at(far + doors.right, WALL_STEP),
        ] {
            rooms.classes[door.index()] = EMPTY;
        }
        rooms
    }

    /// Returns whether the agent can enter the cell.
    pub(super) fn is_free(&self, cell: Cell) -> bool {
        self.classes[cell.index()] != WALL
    }
}

/// Returns the walls, without any door.
const fn walls() -> [u8; CELL_COUNT] {
    let mut classes = [EMPTY; CELL_COUNT];
    let mut index = 0;
    while index < CELL_COUNT {
        if (index % SIZE).is_multiple_of(WALL_STEP) || (index / SIZE).is_multiple_of(WALL_STEP) {
            classes[index] = WALL;
        }
        index += 1;
    }
    classes
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Generates every configuration of the doors.
    pub(in super::super) fn any_rooms() -> impl Strategy<Value = Rooms> {
        let along = 0..ROOM_SIZE;
        (along.clone(), along.clone(), along.clone(), along).prop_map(
            |(upper, lower, left, right)| Rooms::with(Doors { upper, lower, left, right }),
        )
    }

    #[test]
    fn moves_follow_the_axes() {
        let center = Cell::at(5, 7);
        let around = [Cell::at(6, 7), Cell::at(5, 8), Cell::at(4, 7), Cell::at(5, 6)];
        assert_eq!([0, 1, 2, 3].map(|direction| center.neighbor(direction)), around);
    }

    #[test]
    fn shut_rooms_have_256_free_cells_and_a_door_adds_one_each() {
        let free = |rooms: &Rooms| rooms.classes.iter().filter(|class| **class == EMPTY).count();
        assert_eq!(free(&Rooms::SHUT), 256);
        let rooms = Rooms::with(Doors { upper: 0, lower: 7, left: 3, right: 4 });
        assert_eq!(free(&rooms), 260);
        for (x, y) in [(9, 1), (9, 17), (4, 9), (14, 9)] {
            assert!(rooms.is_free(Cell::at(x, y)), "a door at ({x}, {y})");
        }
    }
}
