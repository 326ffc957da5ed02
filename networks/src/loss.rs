//! Losses on a network's outputs. Each function returns a loss and writes its gradient, scaled by a weight, so that
//! the shards of a minibatch add up.

/// Returns the squared error between predictions and targets, times `weight`, and writes its gradient. With a
/// weight of one over the number of rows this is the loss of Equations 1 and 4.
///
/// # Panics
/// If the lengths differ.
pub fn squared_error(
    predictions: &[f32],
    targets: &[f32],
    weight: f32,
    gradient: &mut [f32],
) -> f64 {
    assert_eq!(predictions.len(), targets.len(), "one target for each prediction");
    assert_eq!(predictions.len(), gradient.len(), "one derivative for each prediction");
    let mut total = 0.0;
    for ((prediction, target), derivative) in predictions.iter().zip(targets).zip(gradient) {
        let error = prediction - target;
        *derivative = 2.0 * weight * error;
        total += f64::from(error) * f64::from(error);
    }
    f64::from(weight) * total
}

/// Returns the cross entropy between the sigmoid of the logits and one `label` in [0, 1], times `weight`, and
/// writes its gradient. A discriminator's loss has label 1 for the expert's rows and 0 for the agent's.
///
/// # Panics
/// If the lengths differ.
pub fn binary_cross_entropy(logits: &[f32], label: f32, weight: f32, gradient: &mut [f32]) -> f64 {
    assert_eq!(logits.len(), gradient.len(), "one derivative for each logit");
    let mut total = 0.0;
    for (logit, derivative) in logits.iter().zip(gradient) {
        *derivative = weight * (sigmoid(*logit) - label);
        total += f64::from(softplus(*logit)) - f64::from(label) * f64::from(*logit);
    }
    f64::from(weight) * total
}

/// Returns the loss of pairs whose first output should be above the second, `-log sigmoid(above - below)`, times
/// `weight`, and writes its gradients: the ranking loss of Figure 7.
///
/// # Panics
/// If the lengths differ.
pub fn ranking(
    above: &[f32],
    below: &[f32],
    weight: f32,
    [above_gradient, below_gradient]: [&mut [f32]; 2],
) -> f64 {
    assert_eq!(above.len(), below.len(), "pairs");
    let lead: Vec<f32> = above.iter().zip(below).map(|(above, below)| above - below).collect();
    let loss = binary_cross_entropy(&lead, 1.0, weight, above_gradient);
    assert_eq!(above_gradient.len(), below_gradient.len(), "pairs");
    below_gradient.iter_mut().zip(above_gradient).for_each(|(below, above)| *below = -*above);
    loss
}

/// Computes the logistic function, which turns log-odds into a probability.
pub fn sigmoid(number: f32) -> f32 {
    (1.0 / (1.0 + libm::exp(-f64::from(number)))) as f32
}

/// Computes `log(1 + exp(number))` without overflow.
pub fn softplus(number: f32) -> f32 {
    let number = f64::from(number);
    (number.max(0.0) + libm::log1p(libm::exp(-number.abs()))) as f32
}

/// Computes `temperature x log sum exp(values / temperature)` without overflow.
pub fn log_sum_exp(values: &[f32], temperature: f32) -> f32 {
    let largest = values.iter().fold(f32::NEG_INFINITY, |largest, &value| largest.max(value));
    let sum = values.iter().map(|value| libm::expf((value - largest) / temperature)).sum();
    largest + temperature * libm::logf(sum)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_soft_maximum_lies_between_the_largest_and_that_plus_the_entropy_of_chance() {
        let value = log_sum_exp(&[1.0, 3.0, 2.0, -50.0], 0.01);
        assert!((value - 3.0).abs() < 1e-6, "{value}");
        let equal = log_sum_exp(&[2.0; 4], 0.5);
        assert!((equal - (2.0 + 0.5 * libm::logf(4.0))).abs() < 1e-6, "{equal}");
    }
}
