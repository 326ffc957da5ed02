//! The four rooms: walls that never move and doors that are drawn anew for every episode.
//!
//! The grid is 19 x 19, `x` grows to the right and `y` downward. The outer wall and the two inner
//! walls stand wherever `x` or `y` is 0, 9 or 18, which leaves four rooms of 8 x 8 cells. Each of the
//! four inner wall segments between two rooms has a door of one cell, so the rooms form a ring and
//! every cell can be reached from every other.

use super::class::{EMPTY, WALL};
use protocol::seed::Stream;
use rand::RngExt;

/// Rows of the grid, and columns.
pub(super) const SIZE: usize = 19;

/// Number of cells of the grid, walls included.
pub(super) const CELL_COUNT: usize = SIZE * SIZE;

/// Number of moves; move 0 goes to +x, 1 to +y, 2 to -x and 3 to -y.
pub(super) const MOVE_COUNT: usize = 4;

/// Distance between two walls, and thus the coordinate of the inner ones.
const WALL_STEP: usize = 9;

/// Free cells along one side of a room.
const ROOM_SIZE: usize = WALL_STEP - 1;

/// One cell, by its place in the observation: `19 y + x`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Cell(u16);

impl Cell {
    /// The cell at column `x` and row `y`.
    pub(super) const fn at(x: usize, y: usize) -> Cell {
        assert!(x < SIZE && y < SIZE, "a cell lies on the grid");
        Cell((SIZE * y + x) as u16)
    }

    /// The place of the cell in the observation.
    pub(super) fn index(self) -> usize {
        usize::from(self.0)
    }

    /// The cell that a move leads to. The outer wall keeps every free cell away from the rim, so
    /// from a free cell the move stays on the grid.
    pub(super) fn neighbor(self, direction: usize) -> Cell {
        const OFFSETS: [i16; MOVE_COUNT] = [1, SIZE as i16, -1, -(SIZE as i16)];
        Cell(self.0.wrapping_add_signed(OFFSETS[direction]))
    }
}

/// Where the four doors are, each counted in cells from 0 to 7 along its wall segment.
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
    /// The class of each cell without agent and goal, row by row: `EMPTY` or `WALL`.
    pub(super) classes: [u8; CELL_COUNT],
}

impl Rooms {
    /// The rooms with all doors shut, as they are before the first episode.
    pub(super) const SHUT: Rooms = Rooms { classes: walls() };

    /// Rooms with uniformly drawn doors.
    pub(super) fn draw(stream: &mut Stream) -> Rooms {
        let mut door = || stream.random_range(0..ROOM_SIZE as u32) as usize;
        Rooms::with(Doors { upper: door(), lower: door(), left: door(), right: door() })
    }

    /// Rooms with the doors given.
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

    /// Whether one can stand on the cell.
    pub(super) fn is_free(&self, cell: Cell) -> bool {
        self.classes[cell.index()] != WALL
    }
}

/// The walls without any door.
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

    /// Every configuration of the doors.
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
