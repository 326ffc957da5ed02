//! The encoder of grid observations, as a run's configuration says it.

/// The convolutional encoder of grids of cells. The default is the one the authors ran; the paper's own
/// text gives sizes that would not fit a 19 x 19 grid.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CellsArchitecture {
    /// Channels of the convolutions, in order; each has stride one and a rectifier.
    pub channels: Vec<usize>,
    /// Side of every convolution's window.
    pub kernel: usize,
    /// Side of the squares whose largest number is kept behind the first convolution.
    pub pool: usize,
    /// Outputs of the dense, rectified layer that ends the encoder.
    pub features: usize,
}

impl Default for CellsArchitecture {
    fn default() -> Self {
        Self { channels: vec![16, 32, 64], kernel: 2, pool: 2, features: 64 }
    }
}

impl CellsArchitecture {
    /// Height and width of the image behind each convolution over a grid; none where the grid is too
    /// small, or a kernel or pool has no side.
    pub fn images(&self, grid: [usize; 2]) -> Option<Vec<[usize; 2]>> {
        let mut image = grid;
        let mut images = Vec::new();
        for layer in 0..self.channels.len() {
            let pool = if layer == 0 { self.pool } else { 1 };
            for side in &mut image {
                let windows = (*side + 1).checked_sub(self.kernel.max(1))?;
                *side = windows.checked_div(pool).filter(|side| *side > 0)?;
            }
            images.push(image);
        }
        (self.kernel > 0).then_some(images)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_shrink_by_the_kernel_and_once_by_the_pool() {
        let encoder = CellsArchitecture::default();
        assert_eq!(encoder.images([19, 9]), Some(vec![[9, 4], [8, 3], [7, 2]]));
        assert_eq!(encoder.images([7, 7]), Some(vec![[3, 3], [2, 2], [1, 1]]));
        for grid in [[6, 9], [9, 6], [1, 0]] {
            assert_eq!(encoder.images(grid), None, "{grid:?}");
        }
        for (kernel, pool) in [(0, 2), (2, 0), (usize::MAX, 1)] {
            let encoder = CellsArchitecture { kernel, pool, ..CellsArchitecture::default() };
            assert_eq!(encoder.images([19, 19]), None, "kernel {kernel}, pool {pool}");
        }
    }
}
