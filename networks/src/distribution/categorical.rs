//! Categorical distribution. Parameters are unnormalized log-probabilities; the action is one byte.

use protocol::seed::Stream;
use rand::RngExt;

use crate::loss::log_sum_exp;

/// Returns the index of an action from its byte.
fn index(action: &[u8]) -> usize {
    let &[byte] = action else { panic!("a discrete action has 1 byte, not {}", action.len()) };
    usize::from(byte)
}

/// Writes the index of an action to its byte.
fn write(index: usize, action: &mut [u8]) {
    action.copy_from_slice(&[u8::try_from(index).expect("actions are numbered by a byte")]);
}

/// Draws an action by inverting the cumulative probabilities.
pub(super) fn sample(logits: &[f32], stream: &mut Stream, action: &mut [u8]) {
    let total = log_sum_exp(logits, 1.0);
    let mut left: f32 = stream.random();
    let chosen = logits.iter().position(|logit| {
        left -= libm::expf(logit - total);
        left < 0.0
    });
    // Rounding may leave a small remainder after the last probability.
    write(chosen.unwrap_or(logits.len() - 1), action);
}

/// Writes the action with the largest log-probability.
pub(super) fn mode(logits: &[f32], action: &mut [u8]) {
    let mut best = 0;
    for (index, logit) in logits.iter().enumerate() {
        if *logit > logits[best] {
            best = index;
        }
    }
    write(best, action);
}

/// Returns the normalized log-probability of an action.
pub(super) fn log_probability(logits: &[f32], action: &[u8]) -> f32 {
    logits[index(action)] - log_sum_exp(logits, 1.0)
}

/// Returns the entropy, the sum of `-p ln p`.
pub(super) fn entropy(logits: &[f32]) -> f32 {
    let total = log_sum_exp(logits, 1.0);
    logits.iter().map(|logit| libm::expf(logit - total) * (total - logit)).sum()
}

/// See [`super::Distribution::gradient`].
pub(super) fn gradient(
    logits: &[f32],
    action: &[u8],
    log_probability_derivative: f32,
    entropy_derivative: f32,
    gradient: &mut [f32],
) {
    let (total, entropy) = (log_sum_exp(logits, 1.0), entropy(logits));
    for (derivative, logit) in gradient.iter_mut().zip(logits) {
        let log_probability = logit - total;
        let through_all =
            log_probability_derivative + entropy_derivative * (log_probability + entropy);
        *derivative = -libm::expf(log_probability) * through_all;
    }
    gradient[index(action)] += log_probability_derivative;
}
