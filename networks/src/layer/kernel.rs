//! The multiplication kernel under every layer.
//!
//! A tile is up to six rows by sixteen columns of sums that stay in registers while the inner index
//! runs. Each sum is one chain of fused multiply-adds in ascending order of that index, whatever the
//! tile it lands in; so a number depends on its own row and column only, and not on the size of the
//! batch, the place of the row in it, or the machine. The loops are plain arrays written so that the
//! compiler keeps them in vector registers; `benches/update.rs` notices when it stops doing so.

/// Columns of a tile: two registers of eight numbers.
pub(crate) const COLUMNS: usize = 16;

/// Sixteen neighboring columns of a matrix row, zero where the matrix has fewer. It fills a cache line
/// exactly: loads that straddle two lines cost a fifth of the speed.
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

    /// Adds the first columns to `target`, as many as it has.
    #[inline(always)]
    pub(crate) fn add_to(&self, target: &mut [f32]) {
        if let Ok(full) = <&mut [f32; COLUMNS]>::try_from(&mut *target) {
            full.iter_mut().zip(self.0).for_each(|(target, sum)| *target += sum);
        } else {
            target.iter_mut().zip(self.0).for_each(|(target, sum)| *target += sum);
        }
    }
}

/// Rows of a full tile: twelve registers of sums, leaving four for what is multiplied.
const TILE: usize = 6;

/// How many steps of the inner index are taken between two bounds checks.
const UNROLL: usize = 8;

/// Work that is done tile by tile.
pub(crate) trait Tile {
    /// Does the `R` rows from `first` on.
    fn run<const R: usize>(&mut self, first: usize);
}

/// Covers `0..rows` by full tiles and one smaller tile for what remains.
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

/// Adds to `sums[r]` the products `rows[r][k] * panel[k]` for ascending `k`. Every row is as long as
/// the panel.
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

/// The sums over ascending `m` of `rows[m][first + r] * vectors[m]`, for rows of so many numbers.
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
