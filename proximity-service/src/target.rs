//! What the proximity function is trained towards: the labels of Eq. 1 and Eq. 4.

use protocol::config::{Discounting, RewardConfig};

/// Proximity label of an agent's observation (Eq. 4, second term).
pub const AGENT_TARGET: f32 = 0.0;

/// Proximity label of a demonstration's observation `steps_to_goal` steps before its last one, in
/// [0, 1] (Eq. 1); the last one, at the goal, has 1.
pub fn demonstration_target(steps_to_goal: u32, config: &RewardConfig) -> f32 {
    let steps = f64::from(steps_to_goal);
    match config.discounting {
        Discounting::Linear => (1.0 - config.delta * steps).max(0.0) as f32,
        Discounting::Exponential => libm::pow(config.delta, steps) as f32,
    }
}
