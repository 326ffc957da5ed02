//! The gradient penalty of a discriminator (WGAN-GP). It pulls the norm of the logit's gradient towards 1 between
//! the expert's rows and the agent's.
//!
//! The gradient of the penalty needs the derivative of the norm of an input gradient `g` with respect to the
//! parameters. With `u = g / |g|` held fixed, `d|g| / dw` is the derivative of `dD / dw` along `u`. It is computed
//! as a central difference of two back-propagated gradients.

use nalgebra::DMatrix;
use networks::{Network, Prepared, Workspace};
use protocol::seed::Stream;
use protocol::task::floats;
use rand::RngExt;

use super::input::Rows;

/// Half the width of the central difference, in the units of the network's input. Without normalization these are
/// the units of the observations, and the derivative is coarse for numbers that vary by less than this.
const STEP: f32 = 0.01;

/// Points at which a discriminator's gradient is penalized, and the weight of the penalty.
pub struct GradientPenalty {
    /// Numbers of each point: observations, then extra inputs.
    points: DMatrix<f32>,
    /// Number of extra inputs among them.
    extra_inputs: usize,
    weight: f32,
}

impl GradientPenalty {
    /// Creates a penalty at random points between the first `pairs` rows and their partners in the other half.
    ///
    /// # Panics
    /// If the numbers do not divide into `2 * pairs` rows.
    pub fn between(rows: &Rows, pairs: usize, weight: f32, stream: &mut Stream) -> Self {
        let seen: Vec<f32> = floats(&rows.observations).collect();
        let [own, extra_inputs] =
            [seen.len(), rows.extra_inputs.len()].map(|numbers| numbers / (2 * pairs));
        assert_eq!(
            seen.len() + rows.extra_inputs.len(),
            2 * pairs * (own + extra_inputs),
            "rows in pairs"
        );
        let number = |row: usize, index: usize| {
            if index < own {
                seen[row * own + index]
            } else {
                rows.extra_inputs[row * extra_inputs + index - own]
            }
        };
        let mut points = DMatrix::zeros(own + extra_inputs, pairs);
        for (pair, mut point) in points.column_iter_mut().enumerate() {
            let share: f32 = stream.random();
            for (index, value) in point.iter_mut().enumerate() {
                let (one, other) = (number(pair, index), number(pairs + pair, index));
                *value = share * one + (1.0 - share) * other;
            }
        }
        GradientPenalty { points, extra_inputs, weight }
    }

    /// Adds the gradient of the penalty to that of the parameters.
    pub fn differentiate(
        &self,
        network: &Network,
        prepared: &Prepared,
        workspace: &mut Workspace,
        gradient: &mut [f32],
    ) {
        let directions = self.input_gradients(network, prepared, workspace);
        let pairs = self.points.ncols();
        let mut moved = DMatrix::zeros(self.points.nrows(), 2 * pairs);
        let mut gradients = DMatrix::zeros(1, 2 * pairs);
        for (pair, direction) in directions.column_iter().enumerate() {
            let norm = direction.norm();
            // Where the gradient vanishes, its norm has no derivative.
            let unit = direction * if norm > 0.0 { STEP / norm } else { 0.0 };
            moved.set_column(pair, &(self.points.column(pair) + &unit));
            moved.set_column(pairs + pair, &(self.points.column(pair) - &unit));
            let derivative = self.weight / pairs as f32 * (norm - 1.0) / STEP;
            (gradients[pair], gradients[pairs + pair]) = (derivative, -derivative);
        }
        let rows = self.rows(&moved);
        network.forward(prepared, rows.batch(), workspace);
        network.backward(prepared, rows.batch(), workspace, &gradients, gradient);
    }

    /// Computes the gradient of the logit at each point.
    fn input_gradients(
        &self,
        network: &Network,
        prepared: &Prepared,
        workspace: &mut Workspace,
    ) -> DMatrix<f32> {
        network.forward(prepared, self.rows(&self.points).batch(), workspace);
        let ones = DMatrix::from_element(1, self.points.ncols(), 1.0);
        network.input_gradient(prepared, workspace, &ones).clone()
    }

    fn rows(&self, points: &DMatrix<f32>) -> Rows {
        let own = self.points.nrows() - self.extra_inputs;
        let mut rows = Rows::default();
        for point in points.as_slice().chunks_exact(own + self.extra_inputs) {
            rows.observations.extend(point[..own].iter().flat_map(|number| number.to_le_bytes()));
            rows.extra_inputs.extend(&point[own..]);
        }
        rows
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use networks::RewardArchitecture;
    use protocol::seed::{Purpose, stream};
    use protocol::task::ObservationSpec;

    #[test]
    fn the_gradient_is_that_of_the_penalty() {
        let architecture = RewardArchitecture { hidden: vec![9, 7], ..Default::default() };
        let vector = ObservationSpec::Vector { len: 3 };
        let network = Network::new(architecture.network_shape(vector, 1, 2));
        let mut stream = stream(1, Purpose::RewardWeights, 0, 0);
        let parameters: Vec<f32> = network.initial_parameters(&mut stream);
        let parameters: Vec<f32> = parameters.iter().map(|number| 2.0 * number).collect();
        let mut random = |count| (0..count).map(|_| stream.random::<f32>() * 4.0 - 2.0).collect();
        let seen: Vec<f32> = random(12 * 3);
        let extra_inputs = random(12 * 2);
        let observations = seen.iter().flat_map(|number| number.to_le_bytes()).collect();
        let rows = Rows { observations, extra_inputs };
        let penalty = GradientPenalty::between(&rows, 6, 3.0, &mut stream);
        let mut workspace = Workspace::default();
        let mut value = |parameters: &[f32]| -> f64 {
            let prepared = network.prepare(parameters);
            let gradients = penalty.input_gradients(&network, &prepared, &mut workspace);
            let excess = |norm: f32| f64::from(norm - 1.0).powi(2);
            gradients.column_iter().map(|one| excess(one.norm())).sum::<f64>() * 3.0 / 6.0
        };
        let mut moved = parameters.clone();
        let mut expected = Vec::new();
        for index in 0..parameters.len() {
            let [above, below] = [1e-2, -1e-2].map(|step| {
                moved[index] = parameters[index] + step;
                value(&moved)
            });
            moved[index] = parameters[index];
            expected.push((above - below) / 2e-2);
        }
        let mut gradient = vec![0.0; parameters.len()];
        let prepared = network.prepare(&parameters);
        penalty.differentiate(&network, &prepared, &mut workspace, &mut gradient);
        let square = |number: f64| number * number;
        let norm = expected.iter().copied().map(square).sum::<f64>().sqrt();
        let pairs = gradient.iter().zip(&expected);
        let error =
            pairs.map(|(found, expected)| square(f64::from(*found) - expected)).sum::<f64>().sqrt();
        assert!(norm > 0.1 && error < 0.01 * norm, "error {error} of {norm}");
    }
}
