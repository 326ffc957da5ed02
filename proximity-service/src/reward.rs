//! Computes rewards from proximity and uncertainty (Eq. 5 and its ablations), and from discriminators.

use networks::{RowScore, softplus};
use run::config::{RewardConfig, RewardForm};

/// Computes the rewards of one episode, one per step (Eq. 5): `f(s') - f(s) - lambda U(s')`, and in the last step
/// `f(s')` besides.
///
/// `proximity` and `uncertainty` have one number per observation, so one more than there are steps. With
/// `form = absolute` a step earns the proximity it reaches instead of the increase (Figure 6), and with
/// `form = airl` the log-odds of that proximity. Without `final_bonus` the last step earns no additional proximity
/// ("No Final"). `offset` is added to the reward of every step.
pub(crate) fn rewards(proximity: &[f32], uncertainty: &[f32], config: &RewardConfig) -> Vec<f32> {
    assert_eq!(proximity.len(), uncertainty.len(), "one uncertainty per proximity");
    let steps = proximity.len() - 1;
    let penalty = config.uncertainty as f32;
    let reward = |step: usize| {
        let (before, after) = (proximity[step], proximity[step + 1]);
        let progress = match config.form {
            RewardForm::Difference => after - before,
            RewardForm::Absolute => after,
            RewardForm::Airl => log_odds(after),
            RewardForm::Gail => unreachable!("a configuration has it for discriminators only"),
        };
        let bonus = if config.final_bonus && step + 1 == steps { after } else { 0.0 };
        progress + bonus - penalty * uncertainty[step + 1] + config.offset as f32
    };
    (0..steps).map(reward).collect()
}

/// Computes the rewards of a model with one row per step: from the mean logit of a discriminator or the temporal
/// distance, minus the penalty for the standard deviation, plus `offset`. Only proximity has a final bonus.
pub(crate) fn step_rewards(rows: &[RowScore], config: &RewardConfig) -> Vec<f32> {
    let penalty = config.uncertainty as f32;
    let reward = |row: &RowScore| {
        let own = match config.form {
            // For a discriminator, log D - log(1 - D) is the logit.
            RewardForm::Airl | RewardForm::Difference => row.mean,
            RewardForm::Gail => softplus(row.mean),
            RewardForm::Absolute => unreachable!("a configuration has it for proximity only"),
        };
        own - penalty * row.standard_deviation + config.offset as f32
    };
    rows.iter().map(reward).collect()
}

/// Computes the log-odds of a probability, finite also for 0 and 1.
fn log_odds(probability: f32) -> f32 {
    const LEAST: f32 = 1e-20;
    libm::logf(probability + LEAST) - libm::logf(1.0 - probability + LEAST)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::config;
    use proptest::prelude::*;

    proptest! {
        /// Checks that Eq. 5 without the penalty telescopes: the undiscounted sum of rewards is Eq. 3 with a
        /// discount of 1, the final proximity plus the total increase in proximity.
        #[test]
        fn rewards_telescope_to_the_objective(
            proximity in prop::collection::vec(0.0f32..1.0, 2..60),
        ) {
            let config = RewardConfig { uncertainty: 0.0, ..config() };
            let none = vec![0.0; proximity.len()];
            let sum: f32 = rewards(&proximity, &none, &config).iter().sum();
            let (first, last) = (proximity[0], proximity[proximity.len() - 1]);
            prop_assert!((sum - (last + last - first)).abs() < 1e-4);
        }

        /// Checks the discounted sum of Eq. 5: the final proximity has the discount of the last step, γ^(T-1),
        /// where Eq. 3 has γ^T.
        #[test]
        fn the_final_proximity_is_discounted_as_the_last_step(
            proximity in prop::collection::vec(0.0f32..1.0, 2..60),
            gamma in 0.5f64..1.0,
        ) {
            let config = RewardConfig { uncertainty: 0.0, ..config() };
            let none = vec![0.0; proximity.len()];
            let discounted = |rewards: &[f32]| -> f64 {
                let terms = rewards.iter().enumerate();
                terms.map(|(t, reward)| gamma.powi(t as i32) * f64::from(*reward)).sum()
            };
            let sum = discounted(&rewards(&proximity, &none, &config));
            let steps = proximity.len() - 1;
            let increases: Vec<f32> = proximity.windows(2).map(|pair| pair[1] - pair[0]).collect();
            let last = gamma.powi(steps as i32 - 1) * f64::from(proximity[steps]);
            prop_assert!((sum - (last + discounted(&increases))).abs() < 1e-4);
        }
    }

    #[test]
    fn the_penalty_is_lambda_times_the_uncertainty_reached() {
        let config = RewardConfig { uncertainty: 0.5, ..config() };
        let found = rewards(&[0.25, 0.5, 0.5], &[9.0, 0.25, 1.0], &config);
        assert_eq!(found, [0.25 - 0.125, 0.5 - 0.5]);
    }

    #[test]
    fn ablations_change_what_a_step_earns() {
        let absolute = RewardConfig { uncertainty: 0.0, form: RewardForm::Absolute, ..config() };
        assert_eq!(rewards(&[0.25, 0.5, 0.75], &[0.0; 3], &absolute), [0.5, 1.5]);
        let offset = RewardConfig { uncertainty: 0.0, offset: -0.5, ..config() };
        assert_eq!(rewards(&[0.25, 0.5, 0.75], &[0.0; 3], &offset), [-0.25, 0.5]);
        let row = RowScore { mean: 2.0, standard_deviation: 0.0 };
        assert_eq!(step_rewards(&[row], &offset), [1.5]);
        let no_final = RewardConfig { uncertainty: 0.0, final_bonus: false, ..config() };
        assert_eq!(rewards(&[0.25, 0.5, 0.75], &[0.0; 3], &no_final), [0.25, 0.25]);
    }

    #[test]
    fn the_odds_of_a_proximity_are_finite() {
        let airl = RewardConfig {
            uncertainty: 0.5,
            final_bonus: false,
            form: RewardForm::Airl,
            ..config()
        };
        let found = rewards(&[0.5, 0.25, 1.0, 0.0], &[0.0, 1.0, 0.0, 0.0], &airl);
        assert!((found[0] - (libm::logf(0.25) - libm::logf(0.75) - 0.5)).abs() < 1e-6, "{found:?}");
        assert!((found[1] - 46.0517).abs() < 1e-3 && found[2] == -found[1], "{found:?}");
    }

    #[test]
    fn a_step_rewards_its_logit_or_what_the_agent_would_not_do() {
        let airl = RewardConfig { uncertainty: 0.5, form: RewardForm::Airl, ..config() };
        let row = RowScore { mean: 2.0, standard_deviation: 0.5 };
        assert_eq!(step_rewards(&[row], &airl), [1.75]);
        let gail = RewardConfig { form: RewardForm::Gail, ..airl };
        let agents = 1.0 - 1.0 / (1.0 + libm::expf(-2.0));
        let found = step_rewards(&[row], &gail);
        assert!((found[0] - (-libm::logf(agents) - 0.25)).abs() < 1e-6, "{found:?}");
    }
}
