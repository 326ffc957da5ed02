//! Replay buffer of the agent's newest rows, the negative examples of the online update (Eq. 4).

use std::collections::VecDeque;

/// A first-in, first-out buffer of rows of one length, as [`crate::model::Input`] makes them.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ReplayBuffer {
    bytes: VecDeque<u8>,
    row_bytes: usize,
    capacity: usize,
}

impl ReplayBuffer {
    /// Creates an empty buffer for `capacity` rows of `row_bytes` each.
    pub(crate) fn new(capacity: usize, row_bytes: usize) -> ReplayBuffer {
        let bytes = VecDeque::with_capacity(capacity * row_bytes);
        ReplayBuffer { bytes, row_bytes, capacity }
    }

    /// Returns the number of rows held.
    pub(crate) fn len(&self) -> usize {
        self.bytes.len() / self.row_bytes
    }

    /// Appends rows, given one after another; the oldest rows are dropped to make room.
    pub(crate) fn push(&mut self, rows: &[u8]) {
        assert_eq!(rows.len() % self.row_bytes, 0, "whole rows");
        let room = self.capacity * self.row_bytes;
        let newest = &rows[rows.len().saturating_sub(room)..];
        // Drains first: a buffer that has grown beyond its capacity would keep the larger allocation.
        let excess = (self.bytes.len() + newest.len()).saturating_sub(room);
        self.bytes.drain(..excess);
        self.bytes.extend(newest);
    }

    /// Appends the row at `position` to `rows`; position 0 is the oldest row.
    pub(crate) fn append_to(&self, position: usize, rows: &mut Vec<u8>) {
        let start = position * self.row_bytes;
        rows.extend(self.bytes.range(start..start + self.row_bytes));
    }

    /// Returns all rows, oldest first.
    pub(crate) fn to_bytes(&self) -> Vec<u8> {
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
