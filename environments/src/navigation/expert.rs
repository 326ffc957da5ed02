//! The expert of Navigation: breadth-first search (paper, Section 4.3).
//!
//! One breadth-first search from the goal, at the expert's first action of an episode, gives the distance of every
//! cell. After that, each action only compares four neighbors. Among the moves that lead one step closer the expert
//! takes the one with the lowest number: +x before +y before -x before -y.

use super::rooms::{CELL_COUNT, Cell, MOVE_COUNT, Rooms};

/// Marks cells that the search did not reach: the walls.
const UNREACHED: u8 = u8::MAX;

/// The lengths of the shortest paths from all cells to the goal.
#[derive(Clone, Debug)]
pub(super) struct Distances {
    moves: [u8; CELL_COUNT],
}

impl Distances {
    /// Runs a breadth-first search from the goal.
    pub(super) fn search(rooms: &Rooms, goal: Cell) -> Distances {
        let mut moves = [UNREACHED; CELL_COUNT];
        let mut queue = [goal; CELL_COUNT];
        let (mut head, mut tail) = (0, 1);
        moves[goal.index()] = 0;
        while head < tail {
            let cell = queue[head];
            head += 1;
            for neighbor in (0..MOVE_COUNT).map(|direction| cell.neighbor(direction)) {
                if rooms.is_free(neighbor) && moves[neighbor.index()] == UNREACHED {
                    moves[neighbor.index()] = moves[cell.index()] + 1;
                    queue[tail] = neighbor;
                    tail += 1;
                }
            }
        }
        Distances { moves }
    }

    /// Returns the first move of the shortest path from `cell`, or `None` at the goal.
    pub(super) fn first_move(&self, cell: Cell) -> Option<u8> {
        let distance = self.moves[cell.index()];
        (0..MOVE_COUNT)
            .find(|&direction| self.moves[cell.neighbor(direction).index()] < distance)
            .map(|direction| direction as u8)
    }
}

#[cfg(test)]
mod tests {
    use super::super::rooms::tests::any_rooms;
    use super::super::universe::CELLS;
    use super::*;
    use proptest::prelude::*;

    /// Computes the distances by relaxing all cells until nothing changes: slow, but independent of the search.
    fn relaxed(rooms: &Rooms, goal: Cell) -> [u8; CELL_COUNT] {
        let mut moves = [UNREACHED; CELL_COUNT];
        moves[goal.index()] = 0;
        loop {
            let before = moves;
            for (x, y) in (1..18).flat_map(|y| (1..18).map(move |x| (x, y))) {
                let cell = Cell::at(x, y);
                if rooms.is_free(cell) && cell != goal {
                    let around = [(x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)];
                    let nearest = around.map(|(x, y)| moves[Cell::at(x, y).index()]);
                    let nearest = nearest.into_iter().min().expect("four neighbors");
                    moves[cell.index()] = nearest.saturating_add(1);
                }
            }
            if moves == before {
                return moves;
            }
        }
    }

    #[test]
    fn ties_go_to_the_lowest_move() {
        let goal = Cell::at(3, 3);
        let distances = Distances::search(&Rooms::SHUT, goal);
        let first_move = |x, y| distances.first_move(Cell::at(x, y));
        assert_eq!(first_move(1, 1), Some(0), "right before down");
        assert_eq!(first_move(5, 1), Some(1), "down before left");
        assert_eq!(first_move(5, 5), Some(2), "left before up");
        assert_eq!(first_move(1, 5), Some(0), "right before up");
        assert_eq!(distances.first_move(goal), None);
    }

    proptest! {
        #[test]
        fn every_door_configuration_is_solvable(rooms in any_rooms(), goal in 0..CELLS.len()) {
            let distances = Distances::search(&rooms, CELLS[goal]);
            for index in 0..CELL_COUNT {
                let free = rooms.classes[index] == super::super::class::EMPTY;
                prop_assert_eq!(free, distances.moves[index] != UNREACHED, "cell {}", index);
            }
        }

        #[test]
        fn distances_are_shortest(rooms in any_rooms(), goal in 0..CELLS.len()) {
            let distances = Distances::search(&rooms, CELLS[goal]);
            prop_assert_eq!(distances.moves, relaxed(&rooms, CELLS[goal]));
        }
    }
}
