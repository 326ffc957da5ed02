//! Initial weights, drawn from a given stream.

use std::f64::consts::PI;

use nalgebra::DMatrix;
use protocol::seed::Stream;
use rand::RngExt;

/// How the initial weights and biases of a layer are drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Initialization {
    /// Weights and biases uniform in `±1 / sqrt(fan_in)`.
    FanIn,
    /// A random orthogonal matrix times the gain for the weights, zero for the biases.
    Orthogonal(f64),
}

impl Initialization {
    /// Draws the parameters of a layer: `fan_in x outputs` weights, row by row, then the biases.
    pub(crate) fn draw(self, fan_in: usize, outputs: usize, stream: &mut Stream) -> Vec<f32> {
        match self {
            Initialization::FanIn => {
                let bound = 1.0 / (fan_in as f32).sqrt();
                let number = |_| (2.0 * stream.random::<f32>() - 1.0) * bound;
                (0..(fan_in + 1) * outputs).map(number).collect()
            }
            Initialization::Orthogonal(gain) => {
                let weights = orthogonal(fan_in, outputs, stream);
                let rows = weights.row_iter();
                let numbers = rows.flat_map(|row| row.iter().copied().collect::<Vec<f64>>());
                let numbers = numbers.map(|number| (gain * number) as f32);
                numbers.chain(std::iter::repeat_n(0.0, outputs)).collect()
            }
        }
    }
}

/// Draws a matrix whose rows or columns, whichever are fewer, are orthonormal, uniformly among all such matrices.
fn orthogonal(rows: usize, columns: usize, stream: &mut Stream) -> DMatrix<f64> {
    let (long, short) = (rows.max(columns), rows.min(columns));
    let decomposition = DMatrix::from_fn(long, short, |_, _| standard_normal(stream)).qr();
    let (mut basis, triangle) = (decomposition.q(), decomposition.r());
    for (index, mut column) in basis.column_iter_mut().enumerate() {
        // Without this the signs, and so the draw, would depend on the implementation of the decomposition.
        if triangle[(index, index)] < 0.0 {
            column.neg_mut();
        }
    }
    if rows >= columns { basis } else { basis.transpose() }
}

/// Draws a number from the standard normal distribution (Box and Muller).
pub(crate) fn standard_normal(stream: &mut Stream) -> f64 {
    let radius = (-2.0 * libm::log(1.0 - stream.random::<f64>())).sqrt();
    radius * libm::cos(2.0 * PI * stream.random::<f64>())
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::seed::{Purpose, stream};

    #[test]
    fn the_shorter_side_is_orthonormal() {
        let mut stream = stream(1, Purpose::PolicyWeights, 0, 0);
        for (rows, columns) in [(7, 3), (3, 7), (5, 5), (64, 1)] {
            let matrix = orthogonal(rows, columns, &mut stream);
            assert_eq!(matrix.shape(), (rows, columns));
            let short = if rows >= columns { matrix.transpose() } else { matrix };
            let product = &short * short.transpose();
            assert!((product - DMatrix::identity(short.nrows(), short.nrows())).amax() < 1e-12);
        }
    }

    #[test]
    fn normal_draws_have_the_moments_of_the_normal_distribution() {
        let mut stream = stream(1, Purpose::PolicyWeights, 0, 0);
        let draws: Vec<f64> = (0..100_000).map(|_| standard_normal(&mut stream)).collect();
        let moment = |power| {
            draws.iter().map(|draw| libm::pow(*draw, f64::from(power))).sum::<f64>() / 100_000.0
        };
        for (power, expected, tolerance) in [(1, 0.0, 0.02), (2, 1.0, 0.03), (4, 3.0, 0.15)] {
            let found = moment(power);
            assert!((found - expected).abs() < tolerance, "moment {power} is {found}");
        }
    }

    #[test]
    fn fan_in_draws_stay_within_their_bound() {
        let mut stream = stream(1, Purpose::PolicyWeights, 0, 0);
        let numbers = Initialization::FanIn.draw(16, 8, &mut stream);
        assert_eq!(numbers.len(), 17 * 8);
        assert!(numbers.iter().all(|number| number.abs() <= 0.25));
        assert!(numbers.iter().any(|number| number.abs() > 0.2));
    }
}
