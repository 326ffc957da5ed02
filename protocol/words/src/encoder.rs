//! The encoder of grid observations, as given by a run's configuration.

/// The convolutional encoder of grids of cells. The default is the one the authors ran; the sizes in the paper's text
/// would not fit a 19 x 19 grid.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CellsArchitecture {
    /// Output channels of the convolutions, in order. Each has stride 1 and a ReLU.
    pub channels: Vec<usize>,
    /// Kernel size of every convolution.
    pub kernel: usize,
    /// Window size of the max pooling after the first convolution.
    pub pool: usize,
    /// Outputs of the dense layer with ReLU that ends the encoder.
    pub features: usize,
}

impl Default for CellsArchitecture {
    fn default() -> Self {
        Self { channels: vec![16, 32, 64], kernel: 2, pool: 2, features: 64 }
    }
}

impl CellsArchitecture {
    /// Returns height and width of the image after each convolution and its pooling; `None` if the grid is too small,
    /// or kernel or pool is 0.
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
