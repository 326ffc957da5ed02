//! Losses on a network's outputs; each gives its part of the loss and of the gradient, so that the
//! shards of a minibatch add up.

/// The squared error between predictions and targets, times `weight` (Equations 1 and 4 with the
/// weight one over the number of rows), and its gradient.
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
    assert_eq!(predictions.len(), gradient.len(), "one slope for each prediction");
    let mut total = 0.0;
    for ((prediction, target), slope) in predictions.iter().zip(targets).zip(gradient) {
        let error = prediction - target;
        *slope = 2.0 * weight * error;
        total += f64::from(error) * f64::from(error);
    }
    f64::from(weight) * total
}
