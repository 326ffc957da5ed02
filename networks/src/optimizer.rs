//! The optimizer: clipping by the global norm, and Adam.

use protocol::tensors::Tensors;

/// Decay rate of the first moment.
const BETA_1: f64 = 0.9;

/// Decay rate of the second moment.
const BETA_2: f64 = 0.999;

/// Adam over a flat slice of parameters. Its moments and step count are part of checkpoints.
#[derive(Clone, Debug, PartialEq)]
pub struct Adam {
    /// Running mean of the gradient.
    pub first_moment: Vec<f32>,
    /// Running mean of the squared gradient.
    pub second_moment: Vec<f32>,
    /// Number of updates so far.
    pub step: u64,
    /// Added to the root of the second moment.
    pub epsilon: f64,
    /// Weight decay (AdamW), 0 by default: a step multiplies parameters by `1 - learning_rate * weight_decay`.
    pub weight_decay: f64,
}

impl Adam {
    /// Creates an optimizer for `parameter_count` parameters.
    pub fn new(parameter_count: usize, epsilon: f64) -> Self {
        let [first_moment, second_moment] = [(); 2].map(|()| vec![0.0; parameter_count]);
        Self { first_moment, second_moment, step: 0, epsilon, weight_decay: 0.0 }
    }

    /// Adds the optimizer's state to `tensors`, under `name`.
    pub fn save(&self, name: &str, tensors: &mut Tensors) {
        tensors.put_f32(&format!("{name}.first_moment"), self.first_moment.iter().copied());
        tensors.put_f32(&format!("{name}.second_moment"), self.second_moment.iter().copied());
        tensors.put_u64(&format!("{name}.step"), [self.step]);
    }

    /// Restores the state that [`Adam::save`] added.
    ///
    /// # Errors
    /// When an array is missing or has another length.
    pub fn restore(&mut self, name: &str, tensors: &Tensors) -> Result<(), String> {
        let count = self.first_moment.len();
        let moment = |part: &str| tensors.exactly(&format!("{name}.{part}"), count, Tensors::f32);
        let moments = (moment("first_moment")?, moment("second_moment")?);
        self.step = tensors.exactly(&format!("{name}.step"), 1, Tensors::u64)?[0];
        (self.first_moment, self.second_moment) = moments;
        Ok(())
    }

    /// Takes one gradient descent step.
    ///
    /// # Panics
    /// If the lengths differ from those of the moments.
    pub fn update(&mut self, parameters: &mut [f32], gradient: &[f32], learning_rate: f64) {
        assert_eq!(parameters.len(), self.first_moment.len(), "parameters of this optimizer");
        assert_eq!(gradient.len(), self.first_moment.len(), "parameters of this optimizer");
        self.step += 1;
        let remaining = |beta: f64| 1.0 - libm::pow(beta, self.step as f64);
        let rate = (learning_rate / remaining(BETA_1)) as f32;
        let scale = (1.0 / remaining(BETA_2).sqrt()) as f32;
        let (follow1, follow2) = ((1.0 - BETA_1) as f32, (1.0 - BETA_2) as f32);
        let (keep2, epsilon) = (BETA_2 as f32, self.epsilon as f32);
        let keep = (1.0 - learning_rate * self.weight_decay) as f32;
        let moments = self.first_moment.iter_mut().zip(&mut self.second_moment);
        for ((parameter, derivative), (first, second)) in
            parameters.iter_mut().zip(gradient).zip(moments)
        {
            *first += follow1 * (derivative - *first);
            *second = keep2 * *second + follow2 * derivative * derivative;
            *parameter = keep * *parameter - rate * *first / (second.sqrt() * scale + epsilon);
        }
    }
}

/// Scales a gradient so that its norm is at most `largest`, and returns the original norm.
pub fn clip_global_norm(gradient: &mut [f32], largest: f64) -> f64 {
    let norm = square_sum(gradient).sqrt();
    // As in PyTorch, the small number avoids a division by zero.
    let factor = largest / (norm + 1e-6);
    if factor < 1.0 {
        let factor = factor as f32;
        gradient.iter_mut().for_each(|derivative| *derivative *= factor);
    }
    norm
}

/// Computes the sum of squares in sixteen interleaved sums, which are then added in order.
fn square_sum(numbers: &[f32]) -> f64 {
    let mut sums = [0.0; 16];
    let (chunks, rest) = numbers.as_chunks::<16>();
    let square = |number: f32| f64::from(number) * f64::from(number);
    for chunk in chunks {
        sums.iter_mut().zip(chunk).for_each(|(sum, number)| *sum += square(*number));
    }
    sums.iter_mut().zip(rest).for_each(|(sum, number)| *sum += square(*number));
    sums.iter().sum()
}

/// Adds a shard's gradient to the sum of the previous shards. Adding shards in a fixed order gives the same bits
/// whichever thread computed them.
///
/// # Panics
/// If the lengths differ.
pub(crate) fn add(sum: &mut [f32], shard: &[f32]) {
    assert_eq!(sum.len(), shard.len(), "gradients of the same parameters");
    sum.iter_mut().zip(shard).for_each(|(sum, derivative)| *sum += derivative);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clipping_scales_only_what_is_too_long() {
        let mut gradient = vec![3.0, 0.0, 4.0];
        assert_eq!(clip_global_norm(&mut gradient, 5.1), 5.0);
        assert_eq!(gradient, [3.0, 0.0, 4.0]);
        assert_eq!(clip_global_norm(&mut gradient, 0.5), 5.0);
        assert!((square_sum(&gradient).sqrt() - 0.5).abs() < 1e-6);
        assert_eq!(clip_global_norm(&mut [0.0; 11], 0.5), 0.0);
    }

    #[test]
    fn weights_decay_by_a_part_of_the_learning_rate_whatever_the_gradient() {
        let mut adam = Adam { weight_decay: 0.5, ..Adam::new(2, 1e-8) };
        let mut parameters = [2.0, -4.0];
        adam.update(&mut parameters, &[0.0, 0.0], 0.1);
        assert_eq!(parameters, [1.9, -3.8]);
    }

    #[test]
    fn the_first_step_is_as_long_as_the_learning_rate() {
        let mut adam = Adam::new(2, 1e-8);
        let mut parameters = [1.0, -1.0];
        adam.update(&mut parameters, &[0.3, -20.0], 0.1);
        assert!((parameters[0] - 0.9).abs() < 1e-6 && (parameters[1] + 0.9).abs() < 1e-6);
    }
}
