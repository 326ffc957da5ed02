//! The multiplication kernel of dense layers.
//!
//! A tile is up to six rows by sixteen columns of sums that stay in registers while the inner index runs. Each sum
//! is one chain of fused multiply-adds in ascending order of that index, independent of the tile. So a result
//! depends only on its own row and column, not on the size of the batch, the position of the row in it, or the
//! machine. The loops run over plain arrays so that the compiler keeps them in vector registers;
//! `benches/update.rs` shows whether it does.

/// Columns of a tile: two registers of eight numbers.
pub(crate) const COLUMNS: usize = 16;

/// Sixteen adjacent columns of a matrix row, padded with zeros where the matrix has fewer. A vector fills exactly
/// one cache line: loads that straddle two lines cost a fifth of the speed.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
pub(crate) struct Vector16(pub(crate) [f32; COLUMNS]);

impl Vector16 {
    /// All zeros.
    pub(crate) const ZERO: Vector16 = Vector16([0.0; COLUMNS]);

    /// Copies up to sixteen numbers and fills the rest with zeros.
    #[inline(always)]
    pub(crate) fn of(numbers: &[f32]) -> Self {
        if let Ok(full) = <[f32; COLUMNS]>::try_from(numbers) {
            return Vector16(full);
        }
        let mut vector = Vector16::ZERO;
        vector.0[..numbers.len()].copy_from_slice(numbers);
        vector
    }

    /// Adds the leading columns to `target`, as many as it has.
    #[inline(always)]
    pub(crate) fn add_to(&self, target: &mut [f32]) {
        if let Ok(full) = <&mut [f32; COLUMNS]>::try_from(&mut *target) {
            full.iter_mut().zip(self.0).for_each(|(target, sum)| *target += sum);
        } else {
            target.iter_mut().zip(self.0).for_each(|(target, sum)| *target += sum);
        }
    }
}

/// Rows of a full tile: the sums take twelve registers and leave four for the operands.
const TILE: usize = 6;

/// Steps of the inner index between two bounds checks.
const UNROLL: usize = 8;

/// Work that is processed tile by tile.
pub(crate) trait Tile {
    /// Processes the `R` rows starting at `first`.
    fn run<const R: usize>(&mut self, first: usize);
}

/// Covers `0..rows` with full tiles and one smaller tile for the rest.
pub(crate) fn tiles(rows: usize, tile: &mut impl Tile) {
    let full = rows / TILE * TILE;
    for first in (0..full).step_by(TILE) {
        tile.run::<TILE>(first);
    }
    match rows - full {
        0 => {}
        1 => tile.run::<1>(full),
        2 => tile.run::<2>(full),
        3 => tile.run::<3>(full),
        4 => tile.run::<4>(full),
        _ => tile.run::<5>(full),
    }
}

/// Adds `factor * vector` to `sums`.
#[inline(always)]
fn multiply_add(sums: &mut Vector16, factor: f32, vector: &Vector16) {
    for (sum, number) in sums.0.iter_mut().zip(&vector.0) {
        *sum = factor.mul_add(*number, *sum);
    }
}

/// Adds the products `rows[r][k] * panel[k]` to `sums[r]`, for ascending `k`. Every row is as long as the panel.
#[inline(always)]
pub(crate) fn inner<const R: usize>(
    mut sums: [Vector16; R],
    rows: [&[f32]; R],
    panel: &[Vector16],
) -> [Vector16; R] {
    let (panel_chunks, panel_rest) = panel.as_chunks::<UNROLL>();
    let chunks = rows.map(|row| row.as_chunks::<UNROLL>().0);
    for (chunk, vectors) in panel_chunks.iter().enumerate() {
        let factors = chunks.map(|row| &row[chunk]);
        for (step, vector) in vectors.iter().enumerate() {
            for (sums, factors) in sums.iter_mut().zip(&factors) {
                multiply_add(sums, factors[step], vector);
            }
        }
    }
    let done = panel_chunks.len() * UNROLL;
    for (step, vector) in panel_rest.iter().enumerate() {
        for (sums, row) in sums.iter_mut().zip(&rows) {
            multiply_add(sums, row[done + step], vector);
        }
    }
    sums
}

/// Returns the sums of `rows[m][first + r] * vectors[m]` over ascending `m`, where each row has `row` numbers.
#[inline(always)]
pub(crate) fn outer<const R: usize>(
    rows: &[f32],
    first: usize,
    row: usize,
    vectors: &[Vector16],
) -> [Vector16; R] {
    let mut sums = [Vector16::ZERO; R];
    for (row, vector) in rows.chunks_exact(row).zip(vectors) {
        let factors: &[f32; R] = row[first..].first_chunk().expect("a tile lies inside the row");
        for (sums, factor) in sums.iter_mut().zip(factors) {
            multiply_add(sums, *factor, vector);
        }
    }
    sums
}
