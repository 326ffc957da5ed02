//! The newest rows of the agent, negative examples of the online update (Eq. 4).

use std::collections::VecDeque;

/// A first-in, first-out buffer of rows of one length, as [`crate::model::Input`] makes them.
#[derive(Clone, Debug, PartialEq)]
pub struct ReplayBuffer {
    bytes: VecDeque<u8>,
    row_bytes: usize,
    capacity: usize,
}

impl ReplayBuffer {
    /// An empty buffer for `capacity` rows of `row_bytes` each.
    pub fn new(capacity: usize, row_bytes: usize) -> ReplayBuffer {
        let bytes = VecDeque::with_capacity(capacity * row_bytes);
        ReplayBuffer { bytes, row_bytes, capacity }
    }

    /// Rows held.
    pub fn len(&self) -> usize {
        self.bytes.len() / self.row_bytes
    }

    /// Whether none is held.
    pub fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    /// Takes in rows, one after another; the oldest make room.
    pub fn push(&mut self, rows: &[u8]) {
        assert_eq!(rows.len() % self.row_bytes, 0, "whole rows");
        let room = self.capacity * self.row_bytes;
        let newest = &rows[rows.len().saturating_sub(room)..];
        // Before they come: a buffer that has grown beyond its room stays so large.
        let excess = (self.bytes.len() + newest.len()).saturating_sub(room);
        self.bytes.drain(..excess);
        self.bytes.extend(newest);
    }

    /// The row at `position`, 0 being the oldest, appended to `rows`.
    pub fn append_to(&self, position: usize, rows: &mut Vec<u8>) {
        let start = position * self.row_bytes;
        rows.extend(self.bytes.range(start..start + self.row_bytes));
    }

    /// Every row, oldest first.
    pub fn to_bytes(&self) -> Vec<u8> {
        self.bytes.iter().copied().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_oldest_rows_make_room() {
        let mut buffer = ReplayBuffer::new(3, 2);
        buffer.push(&[1, 1, 2, 2]);
        buffer.push(&[3, 3, 4, 4]);
        assert_eq!(buffer.to_bytes(), [2, 2, 3, 3, 4, 4]);
        let mut row = Vec::new();
        buffer.append_to(1, &mut row);
        assert_eq!((buffer.len(), row), (3, vec![3, 3]));
        let room = buffer.bytes.capacity();
        buffer.push(&[5, 5, 6, 6, 7, 7, 8, 8]);
        assert_eq!(buffer.to_bytes(), [6, 6, 7, 7, 8, 8]);
        assert_eq!(buffer.bytes.capacity(), room);
    }
}
