//! Independent normal distributions. Parameters are means, then logarithms of standard deviations. The action holds
//! the drawn numbers as little-endian `f32`, unclipped: environments clip, the policy does not.

use protocol::seed::Stream;
use protocol::task::{floats, write_floats};

use super::HALF_LOG_TAU;
use crate::initialization::standard_normal;

/// Splits parameters into means and logarithms of standard deviations.
fn split(parameters: &[f32]) -> (&[f32], &[f32]) {
    parameters.split_at(parameters.len() / 2)
}

/// Returns, for each number of the action, its distance from the mean in standard deviations and the logarithm of
/// the standard deviation.
fn distances<'a>(parameters: &'a [f32], action: &'a [u8]) -> impl Iterator<Item = (f32, f32)> + 'a {
    let (means, logs) = split(parameters);
    assert_eq!(action.len(), 4 * means.len(), "bytes of an action of {} numbers", means.len());
    let numbers = floats(action).zip(means).zip(logs);
    numbers.map(|((number, mean), &log)| ((number - mean) * libm::expf(-log), log))
}

/// Draws an action.
pub(super) fn sample(parameters: &[f32], stream: &mut Stream, action: &mut [u8]) {
    let (means, logs) = split(parameters);
    let numbers = means.iter().zip(logs);
    let draw = |(mean, log): (&f32, &f32)| mean + libm::expf(*log) * standard_normal(stream) as f32;
    write_floats(numbers.map(draw), action);
}

/// Writes the means.
pub(super) fn mode(parameters: &[f32], action: &mut [u8]) {
    write_floats(split(parameters).0.iter().copied(), action);
}

/// Returns the log-density of an action.
pub(super) fn log_probability(parameters: &[f32], action: &[u8]) -> f32 {
    let each = distances(parameters, action);
    each.map(|(distance, log)| -0.5 * distance * distance - log - HALF_LOG_TAU).sum()
}

/// Returns the differential entropy.
pub(super) fn entropy(parameters: &[f32]) -> f32 {
    split(parameters).1.iter().map(|log| 0.5 + HALF_LOG_TAU + log).sum()
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
    for ((distance, log), (mean, log_derivative)) in distances(parameters, action).zip(gradients) {
        *mean = log_probability_derivative * distance * libm::expf(-log);
        *log_derivative =
            log_probability_derivative * (distance * distance - 1.0) + entropy_derivative;
    }
}
