//! PPO's loss of one row of a batch, and its gradients: clipped surrogate, entropy bonus, clipped value loss.
//!
//! Pure functions of numbers. The update in the parent module selects the rows and sums over them.

use networks::Distribution;
use run::config::PpoConfig;

use crate::algorithm::Metrics;
use crate::algorithm::policy_trainer::RowOutput;

/// A row of a batch, with its targets.
#[derive(Clone, Copy, Debug)]
pub(super) struct Row<'a> {
    /// The action taken.
    pub(super) action: &'a [u8],
    /// Its log-probability under the policy that acted.
    pub(super) log_probability: f32,
    /// The advantage of the action.
    pub(super) advantage: f32,
    /// The value before the update.
    pub(super) old_value: f32,
    /// The return that the value is fitted to.
    pub(super) target: f32,
}

/// A loss, and its derivative where it was computed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Term {
    /// The loss.
    pub(super) loss: f32,
    /// Its derivative.
    pub(super) derivative: f32,
}

impl Row<'_> {
    /// Returns the row's part of the metrics, with this weight, and the derivative with respect to the value.
    /// Writes the gradients with respect to the parameters of the action distribution.
    pub(super) fn loss(
        &self,
        config: &PpoConfig,
        distribution: Distribution,
        weight: f32,
        output: RowOutput<'_>,
        gradients: &mut [f32],
    ) -> (Metrics, f32) {
        let RowOutput { parameters, value } = output;
        let clip = config.clip as f32;
        let log_probability = distribution.log_probability(parameters, self.action);
        let difference = log_probability - self.log_probability;
        // A ratio that overflows is capped at the largest number.
        let ratio = libm::expf(difference).min(f32::MAX);
        let policy = clipped_surrogate(ratio, self.advantage, clip);
        let entropy_derivative = -(config.entropy_coefficient as f32) * weight;
        let derivative = policy.derivative * weight;
        distribution.gradient(parameters, self.action, derivative, entropy_derivative, gradients);
        let of_value = clipped_value(value, self.old_value, self.target, config.value_clip as f32);
        let wide = f64::from(weight);
        let metrics = Metrics {
            policy_loss: wide * f64::from(policy.loss),
            value_loss: wide * f64::from(of_value.loss),
            entropy: wide * f64::from(distribution.entropy(parameters)),
            approximate_kl: wide * f64::from((ratio - 1.0) - difference),
            clip_fraction: if (ratio - 1.0).abs() > clip { wide } else { 0.0 },
            ..Metrics::default()
        };
        (metrics, config.value_coefficient as f32 * weight * of_value.derivative)
    }
}

/// Returns minus the smaller of two products: the advantage times the probability ratio, and times the ratio
/// clipped to within `clip` of 1. The derivative is with respect to the log-probability.
pub(super) fn clipped_surrogate(ratio: f32, advantage: f32, clip: f32) -> Term {
    let free = ratio * advantage;
    let held = ratio.clamp(1.0 - clip, 1.0 + clip) * advantage;
    Term { loss: -free.min(held), derivative: if free <= held { -free } else { 0.0 } }
}

/// Returns half the larger of two squared errors: of the value, and of the value clipped to within `clip` of
/// the old value. A `clip` of 0 clips nothing. The derivative is with respect to the value.
pub(super) fn clipped_value(value: f32, old: f32, target: f32, clip: f32) -> Term {
    let error = value - target;
    let free = 0.5 * error * error;
    let moved = value - old;
    // Within the range the clipped value is the value itself, not `old + moved`, which is rounded.
    if clip == 0.0 || moved.abs() <= clip {
        return Term { loss: free, derivative: error };
    }
    let held_error = old + clip.copysign(moved) - target;
    let held = 0.5 * held_error * held_error;
    Term { loss: free.max(held), derivative: if free >= held { error } else { 0.0 } }
}
