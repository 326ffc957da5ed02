//! The room cells that starts and goals are drawn from, and the part of them that a coverage keeps.
//!
//! The order is that of the authors' code: the cells of the four rooms, shuffled once. A coverage keeps the first
//! cells of the list, the same for starts and goals, so a coverage of one half keeps one quarter of all pairs. Doors
//! are not in the list.

use super::rooms::Cell;
use protocol::Error;
use protocol::error::within;

/// Smallest number of cells: an episode needs a start and a goal.
const CELLS_MIN: usize = 2;

/// Returns the cells that a coverage keeps: the first of the list, their number rounded down.
pub(super) fn universe(coverage: f64) -> Result<&'static [Cell], Error> {
    // A negative or NaN coverage also gives 0 cells.
    let cells = (CELLS.len() as f64 * coverage) as usize;
    let holds = (CELLS_MIN..=CELLS.len()).contains(&cells) && coverage <= 1.0;
    let expected =
        format!("above 0 and at most 1, and leave at least {CELLS_MIN} of {} cells", CELLS.len());
    within("coverage", holds, &expected, coverage)?;
    Ok(&CELLS[..cells])
}

/// All room cells, in the shuffled order.
pub(super) static CELLS: [Cell; 256] = {
    let mut cells = [Cell::at(0, 0); 256];
    let mut index = 0;
    while index < cells.len() {
        cells[index] = Cell::at(COORDINATES[index].0, COORDINATES[index].1);
        index += 1;
    }
    cells
};

/// Columns and rows of all room cells, in the shuffled order.
#[rustfmt::skip]
const COORDINATES: [(usize, usize); 256] = [
    (14, 14), (1, 7), (11, 8), (11, 16), (16, 6), (8, 11), (16, 12), (5, 17), (2, 2), (4, 7),
    (7, 14), (13, 16), (14, 16), (13, 11), (2, 10), (10, 5), (10, 17), (2, 8), (14, 1), (4, 1),
    (15, 13), (3, 4), (17, 1), (4, 10), (5, 2), (17, 5), (17, 15), (12, 10), (2, 3), (5, 14),
    (8, 10), (14, 2), (3, 14), (8, 16), (13, 17), (4, 2), (12, 7), (3, 3), (11, 4), (2, 11),
    (10, 14), (7, 10), (15, 17), (7, 15), (6, 6), (10, 3), (3, 1), (10, 4), (12, 17), (11, 11),
    (7, 11), (5, 7), (2, 17), (12, 5), (7, 8), (13, 14), (15, 1), (2, 13), (17, 8), (8, 5),
    (14, 6), (6, 14), (16, 15), (17, 7), (14, 11), (3, 10), (15, 5), (7, 12), (11, 2), (16, 3),
    (4, 16), (10, 6), (2, 15), (15, 6), (16, 4), (16, 16), (16, 2), (16, 13), (13, 3), (4, 6),
    (6, 12), (12, 3), (15, 8), (1, 6), (8, 1), (1, 14), (4, 12), (5, 12), (10, 2), (8, 12),
    (12, 6), (13, 13), (15, 15), (4, 8), (2, 5), (5, 4), (4, 5), (6, 3), (16, 1), (3, 7), (17, 6),
    (13, 6), (6, 15), (17, 13), (7, 4), (16, 10), (13, 8), (3, 12), (11, 14), (11, 5), (6, 2),
    (16, 8), (4, 13), (11, 7), (3, 16), (4, 3), (16, 17), (6, 10), (16, 7), (10, 11), (2, 14),
    (1, 1), (1, 3), (11, 6), (6, 7), (14, 5), (11, 15), (4, 17), (7, 17), (17, 16), (14, 3),
    (5, 5), (8, 6), (11, 10), (2, 16), (2, 4), (17, 12), (14, 10), (4, 4), (14, 17), (1, 5),
    (17, 3), (5, 1), (3, 13), (7, 16), (2, 12), (8, 7), (1, 17), (1, 10), (15, 10), (10, 12),
    (10, 7), (10, 15), (10, 1), (6, 5), (5, 15), (4, 14), (6, 1), (17, 4), (4, 11), (3, 8),
    (10, 10), (17, 11), (12, 2), (5, 8), (16, 14), (6, 8), (13, 7), (10, 13), (5, 11), (6, 4),
    (3, 11), (6, 17), (1, 4), (15, 2), (7, 6), (1, 15), (15, 11), (10, 16), (15, 16), (7, 2),
    (5, 13), (12, 1), (5, 3), (12, 13), (1, 8), (6, 13), (13, 10), (15, 7), (13, 4), (12, 4),
    (14, 15), (15, 12), (13, 2), (2, 1), (2, 6), (8, 4), (13, 15), (1, 13), (3, 2), (5, 16),
    (11, 1), (14, 12), (1, 16), (12, 11), (15, 14), (8, 8), (7, 7), (15, 4), (7, 3), (12, 14),
    (6, 16), (12, 15), (8, 15), (17, 14), (11, 17), (14, 13), (6, 11), (8, 3), (13, 12), (7, 1),
    (13, 1), (3, 6), (8, 2), (11, 13), (5, 10), (17, 10), (8, 13), (8, 17), (1, 11), (5, 6),
    (4, 15), (16, 11), (1, 2), (7, 5), (3, 15), (1, 12), (3, 17), (14, 8), (14, 4), (16, 5),
    (12, 8), (11, 12), (11, 3), (12, 16), (12, 12), (17, 2), (17, 17), (3, 5), (8, 14), (10, 8),
    (15, 3), (2, 7), (13, 5), (7, 13), (14, 7),
];

#[cfg(test)]
mod tests {
    use super::super::rooms::Rooms;
    use super::*;

    #[test]
    fn the_list_has_every_room_cell_once() {
        let mut cells = CELLS;
        cells.sort();
        assert!(cells.is_sorted_by(|cell, next| cell < next), "no cell twice");
        assert!(cells.iter().all(|cell| Rooms::SHUT.is_free(*cell)), "no wall and no door");
    }

    #[test]
    fn a_coverage_keeps_the_first_cells() {
        let counts = [(0.25, 64), (0.5, 128), (0.75, 192), (1.0, 256), (0.3, 76), (2.0 / 256.0, 2)];
        for (coverage, cells) in counts {
            assert_eq!(universe(coverage), Ok(&CELLS[..cells]), "coverage {coverage}");
        }
    }

    #[test]
    fn what_is_no_coverage_is_refused() {
        for coverage in [0.0, 0.005, 1.001, 7.0, -0.5, f64::NAN, f64::INFINITY] {
            let refused = universe(coverage).unwrap_err();
            assert!(matches!(refused, Error::Configuration { .. }), "coverage {coverage}");
        }
        assert_eq!(
            universe(0.005).unwrap_err().to_string(),
            "configuration: `coverage` must be above 0 and at most 1, and leave at least 2 of 256 cells, \
             found 0.005"
        );
    }
}
