//! Hyperbolic tangents of independent normal numbers: the policy of soft actor-critic. Parameters are means, then
//! logarithms of standard deviations, which are clamped. The action holds its numbers as little-endian `f32` in
//! [-1, 1].

use protocol::seed::Stream;
use protocol::task::{floats, write_floats};

use super::{Distribution, HALF_LOG_TAU};
use crate::initialization::standard_normal;
use crate::layer::activation::tanh;

/// Added to the derivative of the squashing function before its logarithm is taken.
const FLATTEST: f32 = 1e-6;

/// Normal distribution of one action component before squashing.
struct Normal {
    mean: f32,
    log: f32,
    /// Derivative of the clamped logarithm with respect to its parameter: 1 or 0.
    log_derivative: f32,
}

fn normals(parameters: &[f32]) -> impl Iterator<Item = Normal> + '_ {
    let (means, logs) = parameters.split_at(parameters.len() / 2);
    let (least, largest) = Distribution::LOG_STANDARD_DEVIATIONS;
    means.iter().zip(logs).map(move |(&mean, &parameter)| {
        let within = (least..=largest).contains(&parameter);
        Normal { mean, log: parameter.clamp(least, largest), log_derivative: f32::from(within) }
    })
}

/// Returns the normal numbers that an action was squashed from.
fn unsquashed(action: &[u8]) -> impl Iterator<Item = f32> + '_ {
    floats(action).map(|number| libm::atanhf(number.clamp(-1.0 + FLATTEST, 1.0 - FLATTEST)))
}

/// Returns the log-density of one action component, given its distance from the mean in standard deviations.
fn log_density(normal: &Normal, distance: f32, squashed: f32) -> f32 {
    let before = -0.5 * distance * distance - normal.log - HALF_LOG_TAU;
    before - libm::logf(1.0 - squashed * squashed + FLATTEST)
}

/// See [`super::Distribution::draw`].
pub(super) fn draw(
    parameters: &[f32],
    stream: &mut Stream,
    noise: &mut [f32],
    action: &mut [f32],
) -> f32 {
    let mut log_probability = 0.0;
    for ((normal, noise), number) in normals(parameters).zip(noise).zip(action) {
        *noise = standard_normal(stream) as f32;
        *number = tanh(normal.mean + libm::expf(normal.log) * *noise);
        log_probability += log_density(&normal, *noise, *number);
    }
    log_probability
}

/// See [`super::Distribution::pathwise_gradient`].
pub(super) fn pathwise_gradient(
    parameters: &[f32],
    noise: &[f32],
    action_gradients: &[f32],
    log_probability_derivative: f32,
    gradient: &mut [f32],
) {
    let (mean_gradients, log_gradients) = gradient.split_at_mut(parameters.len() / 2);
    let gradients = mean_gradients.iter_mut().zip(log_gradients);
    let numbers = normals(parameters).zip(noise).zip(action_gradients);
    for (((normal, noise), action_derivative), (mean, log)) in numbers.zip(gradients) {
        let distance = libm::expf(normal.log) * noise;
        let squashed = tanh(normal.mean + distance);
        let flatness = 1.0 - squashed * squashed;
        let of_density = 2.0 * squashed * flatness / (flatness + FLATTEST);
        let through = action_derivative * flatness + log_probability_derivative * of_density;
        *mean = through;
        *log = (through * distance - log_probability_derivative) * normal.log_derivative;
    }
}

/// Draws an action.
pub(super) fn sample(parameters: &[f32], stream: &mut Stream, action: &mut [u8]) {
    let number = |normal: Normal| {
        tanh(normal.mean + libm::expf(normal.log) * standard_normal(stream) as f32)
    };
    write_floats(normals(parameters).map(number), action);
}

/// Writes the squashed means.
pub(super) fn mode(parameters: &[f32], action: &mut [u8]) {
    write_floats(normals(parameters).map(|normal| tanh(normal.mean)), action);
}

/// Returns the log-density of an action.
pub(super) fn log_probability(parameters: &[f32], action: &[u8]) -> f32 {
    let density = |(normal, number): (Normal, f32)| {
        let distance = (number - normal.mean) * libm::expf(-normal.log);
        log_density(&normal, distance, tanh(number))
    };
    normals(parameters).zip(unsquashed(action)).map(density).sum()
}

/// Returns the differential entropy before squashing.
pub(super) fn entropy(parameters: &[f32]) -> f32 {
    normals(parameters).map(|normal| 0.5 + HALF_LOG_TAU + normal.log).sum()
}

/// See [`super::Distribution::gradient`].
pub(super) fn gradient(
    parameters: &[f32],
    action: &[u8],
    log_probability_derivative: f32,
    entropy_derivative: f32,
    gradient: &mut [f32],
) {
    let (mean_gradients, log_gradients) = gradient.split_at_mut(parameters.len() / 2);
    let gradients = mean_gradients.iter_mut().zip(log_gradients);
    for ((normal, number), (mean, log)) in
        normals(parameters).zip(unsquashed(action)).zip(gradients)
    {
        let distance = (number - normal.mean) * libm::expf(-normal.log);
        *mean = log_probability_derivative * distance * libm::expf(-normal.log);
        let of_log = log_probability_derivative * (distance * distance - 1.0) + entropy_derivative;
        *log = of_log * normal.log_derivative;
    }
}

#[cfg(test)]
mod tests {
    use protocol::seed::{Purpose, stream};

    use super::*;

    const PARAMETERS: [f32; 4] = [0.3, -0.8, 0.2, -0.4];

    #[test]
    fn a_drawn_action_has_the_log_probability_it_was_drawn_with() {
        let mut stream = stream(1, Purpose::TrainingActions, 0, 0);
        for _ in 0..100 {
            let (mut noise, mut action, mut bytes) = ([0.0; 2], [0.0; 2], [0; 8]);
            let drawn = draw(&PARAMETERS, &mut stream, &mut noise, &mut action);
            assert!(action.iter().all(|number| number.abs() <= 1.0));
            write_floats(action, &mut bytes);
            let found = log_probability(&PARAMETERS, &bytes);
            let flat = action.iter().any(|number| number.abs() > 0.999);
            assert!(flat || (found - drawn).abs() < 1e-2, "drawn {drawn}, found {found}");
        }
    }

    /// Uses a weighted sum of the action's components and its log-probability as the loss.
    #[test]
    fn the_pathwise_gradient_is_that_of_finite_differences() {
        let weights = [0.7, -1.3, 0.4];
        let noise = [0.6f32, -1.1];
        let loss = |parameters: &[f32]| -> f64 {
            let each = normals(parameters).zip(noise).zip(weights);
            let numbers = each.map(|((normal, noise), weight)| {
                let action = tanh(normal.mean + libm::expf(normal.log) * noise);
                f64::from(weight * action + weights[2] * log_density(&normal, noise, action))
            });
            numbers.sum()
        };
        let mut gradient = [0.0; 4];
        pathwise_gradient(&PARAMETERS, &noise, &weights[..2], weights[2], &mut gradient);
        for (index, derivative) in gradient.into_iter().enumerate() {
            let moved = |by: f32| {
                let mut parameters = PARAMETERS;
                parameters[index] += by;
                loss(&parameters)
            };
            let expected = (moved(1e-2) - moved(-1e-2)) / 2e-2;
            assert!(
                (f64::from(derivative) - expected).abs() < 1e-3,
                "{index}: {derivative} {expected}"
            );
        }
    }
}
