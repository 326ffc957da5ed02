//! What the proximity function is trained towards: the labels of Eq. 1 and Eq. 4.

use run::config::RewardConfig;

/// Proximity label of an agent's observation (Eq. 4, second term).
pub const AGENT_TARGET: f32 = 0.0;

/// Proximity label of a demonstration's observation `steps_to_goal` steps before its last one, in
/// [0, 1] (Eq. 1); the last one, at the goal, has 1.
pub fn demonstration_target(steps_to_goal: u32, config: &RewardConfig) -> f32 {
    config.label(steps_to_goal) as f32
}

#[cfg(test)]
mod tests {
    use run::config::Discounting;

    use super::*;
    use crate::tests::config;

    #[test]
    fn linear_labels_fall_by_delta_per_step_to_zero() {
        let config = RewardConfig { delta: 0.02, discounting: Discounting::Linear, ..config() };
        let labels = [0, 1, 10, 50, 60].map(|steps| demonstration_target(steps, &config));
        assert_eq!(labels, [1.0, 0.98, 0.8, 0.0, 0.0]);
    }

    #[test]
    fn exponential_labels_fall_by_a_factor_per_step() {
        let config = RewardConfig { delta: 0.5, discounting: Discounting::Exponential, ..config() };
        let labels = [0, 1, 3].map(|steps| demonstration_target(steps, &config));
        assert_eq!(labels, [1.0, 0.5, 0.125]);
    }
}
