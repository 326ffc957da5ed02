//! PPO's loss of a row, checked against finite differences of its definition in double precision; and which
//! episodes are bootstrapped.

use networks::PolicyArchitecture;
use proptest::prelude::*;
use protocol::task::{ActionSpec, ObservationSpec, floats, write_floats};

use super::loss::{Row, clipped_value};
use super::*;
use crate::batch::EpisodeRows;

const STEP: f64 = 1e-5;

fn config(clip: f64, value_clip: f64) -> PpoConfig {
    PpoConfig {
        learning_rate: 0.003,
        learning_rate_decay: false,
        decay_steps: 0,
        adam_epsilon: 1e-5,
        gamma: 0.9,
        gae_lambda: 0.95,
        clip,
        value_clip,
        value_coefficient: 0.7,
        entropy_coefficient: 0.3,
        epochs: 1,
        target_kl: 0.0,
        minibatches: 1,
        max_gradient_norm: 0.5,
        bootstrap_truncated: false,
        normalize_rewards: false,
    }
}

/// Returns the log-probability of an action, up to terms that depend on no parameter, and the entropy.
fn of_distribution(distribution: Distribution, parameters: &[f64], action: &[u8]) -> (f64, f64) {
    let (first, second) = parameters.split_at(parameters.len() / 2);
    let half_log_tau = 0.5 * libm::log(std::f64::consts::TAU);
    let normal = |numbers: Vec<f64>| {
        let each = numbers.into_iter().zip(first).zip(second);
        let each = each.map(|((number, mean), log)| {
            let distance = (number - mean) / libm::exp(*log);
            (-0.5 * distance * distance - log, 0.5 + half_log_tau + log)
        });
        each.fold((0.0, 0.0), |sum, own| (sum.0 + own.0, sum.1 + own.1))
    };
    match distribution {
        Distribution::Categorical { .. } => {
            let total = libm::log(parameters.iter().map(|&logit| libm::exp(logit)).sum());
            let terms = parameters.iter().map(|logit| libm::exp(logit - total) * (total - logit));
            (parameters[usize::from(action[0])] - total, terms.sum())
        }
        Distribution::Gaussian { .. } => normal(floats(action).map(f64::from).collect()),
        Distribution::SquashedGaussian { .. } => {
            normal(floats(action).map(|number| libm::atanh(f64::from(number))).collect())
        }
    }
}

/// A row, the network's output for it, and the settings of its loss.
#[derive(Clone, Debug)]
struct Case {
    distribution: Distribution,
    parameters: Vec<f32>,
    action: Vec<u8>,
    /// Logarithm of the ratio of probabilities.
    difference: f32,
    advantage: f32,
    value: f32,
    old_value: f32,
    target: f32,
    clip: f64,
    value_clip: f64,
}

impl Case {
    /// Computes the loss as the PPO paper defines it, with values clipped as the authors do.
    fn by_definition(&self, parameters: &[f64], value: f64) -> f64 {
        let config = config(self.clip, self.value_clip);
        let given: Vec<f64> = self.parameters.iter().copied().map(f64::from).collect();
        let of = |parameters: &[f64]| of_distribution(self.distribution, parameters, &self.action);
        let (log_probability, entropy) = of(parameters);
        let ratio = libm::exp(log_probability - of(&given).0 + f64::from(self.difference));
        let advantage = f64::from(self.advantage);
        let held = ratio.clamp(1.0 - self.clip, 1.0 + self.clip) * advantage;
        let surrogate = (ratio * advantage).min(held);
        let (old, target) = (f64::from(self.old_value), f64::from(self.target));
        let reach = if self.value_clip == 0.0 { f64::INFINITY } else { self.value_clip };
        let held = old + (value - old).clamp(-reach, reach);
        let error = (value - target).powi(2).max((held - target).powi(2));
        -surrogate - config.entropy_coefficient * entropy + config.value_coefficient * 0.5 * error
    }

    /// Returns whether no clipping begins or ends within the range of the finite differences, or of rounding.
    fn is_smooth(&self) -> bool {
        let ratio = libm::exp(f64::from(self.difference));
        let moved = f64::from(self.value - self.old_value);
        let from_target = f64::from(self.old_value - self.target);
        let held = from_target + moved.clamp(-self.value_clip, self.value_clip);
        let free = from_target + moved;
        let outside = self.value_clip > 0.0 && moved.abs() > self.value_clip;
        ((ratio - 1.0).abs() - self.clip).abs() > 1e-3
            && (self.value_clip == 0.0 || (moved.abs() - self.value_clip).abs() > 1e-3)
            && (!outside || (free.abs() - held.abs()).abs() > 1e-3)
    }

    fn check(&self) -> Result<(), TestCaseError> {
        let distribution = self.distribution;
        let row = Row {
            action: &self.action,
            log_probability: distribution.log_probability(&self.parameters, &self.action)
                - self.difference,
            advantage: self.advantage,
            old_value: self.old_value,
            target: self.target,
        };
        let config = config(self.clip, self.value_clip);
        let mut gradients = vec![0.0; self.parameters.len()];
        let output = RowOutput { parameters: &self.parameters, value: self.value };
        let (metrics, value_derivative) =
            row.loss(&config, distribution, 1.0, output, &mut gradients);

        let mut at: Vec<f64> = self.parameters.iter().copied().map(f64::from).collect();
        let value = f64::from(self.value);
        let close = |what: &str, found: f64, expected: f64| {
            let enough = (found - expected).abs() <= 1e-3 * (1.0 + expected.abs());
            prop_assert!(enough, "{what}: {found}, by definition {expected}");
            Ok(())
        };
        let Metrics { policy_loss, value_loss, entropy, .. } = metrics;
        let loss = policy_loss - config.entropy_coefficient * entropy
            + config.value_coefficient * value_loss;
        close("loss", loss, self.by_definition(&at, value))?;
        let of_value = |by: f64| self.by_definition(&at, value + by);
        let expected = (of_value(STEP) - of_value(-STEP)) / (2.0 * STEP);
        close("derivative of the value", f64::from(value_derivative), expected)?;
        for (index, derivative) in gradients.into_iter().enumerate() {
            let given = at[index];
            let mut moved = |by: f64| {
                at[index] = given + by;
                self.by_definition(&at, value)
            };
            let expected = (moved(STEP) - moved(-STEP)) / (2.0 * STEP);
            at[index] = given;
            close(&format!("derivative of parameter {index}"), f64::from(derivative), expected)?;
        }
        Ok(())
    }
}

/// Generates a distribution, its parameters and one of its actions.
fn distributions() -> impl Strategy<Value = (Distribution, Vec<f32>, Vec<u8>)> {
    let numbers = |range: std::ops::Range<f32>| prop::collection::vec(range, 2);
    let discrete = (prop::collection::vec(-2.0f32..2.0, 4), 0u8..4).prop_map(|(logits, action)| {
        (Distribution::Categorical { count: 4 }, logits, vec![action])
    });
    let continuous = (any::<bool>(), numbers(-0.9..0.9), numbers(-0.7..0.7), numbers(-0.9..0.9));
    let continuous = continuous.prop_map(|(squashed, means, logs, action)| {
        let mut bytes = vec![0; 8];
        write_floats(action, &mut bytes);
        let distribution = match squashed {
            true => Distribution::SquashedGaussian { len: 2 },
            false => Distribution::Gaussian { len: 2 },
        };
        (distribution, [means, logs].concat(), bytes)
    });
    prop_oneof![discrete, continuous]
}

prop_compose! {
    fn cases()(
        (distribution, parameters, action) in distributions(),
        (difference, advantage) in (-0.8f32..0.8, -3.0f32..3.0),
        (value, old_value, target) in (-2.0f32..2.0, -2.0f32..2.0, -2.0f32..2.0),
        near in prop::option::of(-0.1f32..0.1),
        (clip, value_clip) in (0.05f64..0.5, prop_oneof![Just(0.0), 0.05f64..0.5]),
    ) -> Case {
        let value = near.map_or(value, |near| old_value + near);
        Case {
            distribution, parameters, action, difference, advantage, value, old_value, target,
            clip, value_clip,
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn a_rows_slopes_are_the_finite_differences_of_its_definition(
        case in cases().prop_filter("a clip begins or ends here", Case::is_smooth)
    ) {
        case.check()?;
    }

    #[test]
    fn a_value_within_the_range_is_pulled_with_its_whole_error(
        old in -0.2f64..0.2,
        part in -1.0f64..1.0,
        target in -0.2f32..0.2,
        clip in 0.05f32..0.5,
    ) {
        // Rounded separately, as a network's values are: `value - old` is hardly ever exact.
        let moved = 0.99 * part * f64::from(clip);
        let (value, old) = ((old + moved) as f32, old as f32);
        let error = value - target;
        let found = clipped_value(value, old, target, clip);
        prop_assert_eq!((found.loss, found.derivative), (0.5 * error * error, error));
        let unclipped = clipped_value(value, old, target, 0.0);
        prop_assert_eq!((unclipped.loss, unclipped.derivative), (0.5 * error * error, error));
    }
}

/// Two one-step episodes earn 0.25 each; the horizon cut off the first.
#[test]
fn a_cut_episode_is_bootstrapped_with_the_value_of_its_last_state_and_no_other_is() {
    let spec = Spec {
        observation: ObservationSpec::Vector { len: 1 },
        action: ActionSpec::Discrete { count: 2 },
        horizon_steps: 1,
    };
    let bytes = |numbers: &[f32]| numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
    let episode = |last: f32, truncated| EpisodeRows {
        steps: 1,
        last_observation: bytes(&[last]),
        truncated,
    };
    let batch = RolloutBatch {
        observations: bytes(&[0.1, 0.2]),
        actions: vec![0, 1],
        log_probs: vec![-0.7; 2],
        rewards: vec![0.25; 2],
        episodes: vec![episode(0.8, true), episode(-0.6, false)],
    };
    let architecture = PolicyArchitecture { hidden: vec![4], ..PolicyArchitecture::default() };
    let network = ActorCritic::new(spec.observation, spec.action, &architecture);
    let mut stream = seed::stream(1, Purpose::PolicyWeights, 0, 0);
    let parameters = network.initial_parameters(&mut stream);
    let mut update = PpoUpdate::new(spec, config(0.2, 0.2), network);

    let observations = Observations::Bytes(&batch.observations);
    let last = Observations::Bytes(&batch.episodes[0].last_observation);
    let last_value = update.trainer.values(&parameters, last)[0];
    assert!(last_value.abs() > 0.01, "a value that would be noticed, not {last_value}");
    let near = |found: Vec<f32>, expected: [f32; 2]| {
        let close =
            found.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-6);
        assert!(close, "expected {expected:?}, found {found:?}");
    };
    near(update.targets(&parameters, &batch, observations).returns, [0.25, 0.25]);
    update.config.bootstrap_truncated = true;
    near(
        update.targets(&parameters, &batch, observations).returns,
        [0.25 + 0.9 * last_value, 0.25],
    );
}
