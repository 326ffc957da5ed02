//! Generalized advantage estimation over one whole episode (Schulman et al., 2016): the advantage of step `t` is the
//! sum over `k >= 0` of `(gamma lambda)^k d(t + k)`, where `d(t) = r(t) + gamma V(s(t + 1)) - V(s(t))`.

/// Computes the advantages and returns of one episode's steps.
///
/// `values` has one number per step; `last_value` is the value of the final observation, or 0 if no reward can
/// follow the episode's end. Returns `(advantages, returns)`, each with one number per step.
pub(crate) fn generalized_advantages(
    rewards: &[f32],
    values: &[f32],
    last_value: f32,
    gamma: f32,
    lambda: f32,
) -> (Vec<f32>, Vec<f32>) {
    assert_eq!(rewards.len(), values.len(), "one value per reward");
    let mut advantages = vec![0.0; rewards.len()];
    let mut next_value = last_value;
    let mut advantage = 0.0;
    for step in (0..rewards.len()).rev() {
        let error = rewards[step] + gamma * next_value - values[step];
        advantage = error + gamma * lambda * advantage;
        advantages[step] = advantage;
        next_value = values[step];
    }
    let returns = advantages.iter().zip(values).map(|(advantage, value)| advantage + value);
    let returns = returns.collect();
    (advantages, returns)
}

/// Shifts and scales advantages to mean 0 and standard deviation 1, as the authors do once per rollout
/// (unbiased standard deviation plus 1e-5).
pub(crate) fn normalize(advantages: &mut [f32]) {
    let count = advantages.len() as f64;
    let mean = advantages.iter().map(|&advantage| f64::from(advantage)).sum::<f64>() / count;
    let squares = advantages.iter().map(|&advantage| (f64::from(advantage) - mean).powi(2));
    let deviation = (squares.sum::<f64>() / (count - 1.0).max(1.0)).sqrt() + 1e-5;
    for advantage in advantages {
        *advantage = ((f64::from(*advantage) - mean) / deviation) as f32;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Computes the definition: A_t is the sum over k of (gamma lambda)^k times the TD error at t + k.
    fn by_definition(
        rewards: &[f32],
        values: &[f32],
        last: f32,
        gamma: f32,
        lambda: f32,
    ) -> Vec<f64> {
        let value = |step: usize| f64::from(*values.get(step).unwrap_or(&last));
        let error = |step: usize| {
            f64::from(rewards[step]) + f64::from(gamma) * value(step + 1) - value(step)
        };
        let decay = f64::from(gamma) * f64::from(lambda);
        let terms = |step: usize| {
            (step..rewards.len()).map(move |k| decay.powi((k - step) as i32) * error(k)).sum()
        };
        (0..rewards.len()).map(terms).collect()
    }

    proptest! {
        #[test]
        fn agrees_with_the_definition(
            steps in prop::collection::vec((-1.0f32..1.0, -1.0f32..1.0), 1..40),
            last in -1.0f32..1.0,
            gamma in 0.5f32..1.0,
            lambda in 0.0f32..1.0,
        ) {
            let (rewards, values): (Vec<_>, Vec<_>) = steps.into_iter().unzip();
            let (found, returns) = generalized_advantages(&rewards, &values, last, gamma, lambda);
            let expected = by_definition(&rewards, &values, last, gamma, lambda);
            for step in 0..rewards.len() {
                prop_assert!((f64::from(found[step]) - expected[step]).abs() < 1e-4);
                prop_assert!((returns[step] - found[step] - values[step]).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn normalized_advantages_have_mean_zero_and_deviation_one() {
        let mut advantages = vec![1.0, 2.0, 3.0, 4.0];
        normalize(&mut advantages);
        assert!(advantages.iter().sum::<f32>().abs() < 1e-5);
        let squares: f32 = advantages.iter().map(|advantage| advantage * advantage).sum();
        assert!((squares / 3.0 - 1.0).abs() < 1e-3);
    }
}
