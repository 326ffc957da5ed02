//! The reward made from proximity and uncertainty: Eq. 5 and its ablations.

use protocol::config::{RewardConfig, RewardForm};

/// Rewards of one episode, one per step (Eq. 5).
///
/// `proximity` and `uncertainty` have one number per observation, so one more than there are steps.
/// With `form = absolute` a step earns the proximity it reaches instead of the increase (Figure 6);
/// without `final_bonus` the last step earns no extra proximity ("No Final").
pub fn rewards(proximity: &[f32], uncertainty: &[f32], config: &RewardConfig) -> Vec<f32> {
    assert_eq!(proximity.len(), uncertainty.len(), "one uncertainty per proximity");
    let steps = proximity.len() - 1;
    let penalty = config.uncertainty as f32;
    let reward = |step: usize| {
        let (before, after) = (proximity[step], proximity[step + 1]);
        let progress = match config.form {
            RewardForm::Difference => after - before,
            RewardForm::Absolute => after,
        };
        let bonus = if config.final_bonus && step + 1 == steps { after } else { 0.0 };
        progress + bonus - penalty * uncertainty[step + 1]
    };
    (0..steps).map(reward).collect()
}
