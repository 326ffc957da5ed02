//! Whole PPO updates against PyTorch: discrete, normal and squashed actions, with clipped values and
//! bootstrapped episodes, and without both.
//!
//! `ppo_vectors.safetensors` was made by `ppo_vectors.py` beside it with PyTorch 2.5.1, in double
//! precision.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use learner::algorithm::Schedule;
use learner::algorithm::ppo::PpoUpdate;
use learner::batch::{EpisodeRows, RolloutBatch};
use networks::{ActorCritic, PolicyArchitecture};
use protocol::task::{ActionSpec, ObservationSpec, Spec, floats};
use run::config::PpoConfig;
use safetensors::SafeTensors;

const NUMBERS: usize = 5;
const HIDDEN: usize = 6;

/// One case of the file.
struct Case {
    name: &'static str,
    tensors: SafeTensors<'static>,
}

impl Case {
    fn open(name: &'static str) -> Self {
        let bytes = include_bytes!("ppo_vectors.safetensors");
        Self { name, tensors: SafeTensors::deserialize(bytes).expect("the file is whole") }
    }

    fn bytes(&self, key: &str) -> &'static [u8] {
        let key = format!("{}.{key}", self.name);
        self.tensors.tensor(&key).unwrap_or_else(|error| panic!("{key}: {error}")).data()
    }

    fn numbers(&self, key: &str) -> Vec<f32> {
        floats(self.bytes(key)).collect()
    }

    fn batch(&self) -> RolloutBatch {
        let last = self.bytes("last_observations").chunks_exact(4 * NUMBERS);
        let episodes = self.bytes("steps").iter().zip(self.bytes("cut")).zip(last);
        let episodes = episodes.map(|((&steps, &cut), last)| EpisodeRows {
            steps: usize::from(steps),
            last_observation: last.to_vec(),
            truncated: cut == 1,
        });
        RolloutBatch {
            observations: self.bytes("observations").to_vec(),
            actions: self.bytes("actions").to_vec(),
            log_probs: self.numbers("log_probs"),
            rewards: self.numbers("rewards"),
            episodes: episodes.collect(),
        }
    }

    fn config(&self) -> PpoConfig {
        PpoConfig {
            learning_rate: 0.02,
            learning_rate_decay: false,
            decay_steps: 0,
            adam_epsilon: 1e-3,
            gamma: 0.99,
            gae_lambda: 0.95,
            clip: 0.2,
            value_clip: f64::from(self.numbers("value_clip")[0]),
            value_coefficient: 0.5,
            entropy_coefficient: 0.02,
            epochs: 8,
            target_kl: 0.0,
            minibatches: 1,
            max_gradient_norm: 0.5,
            bootstrap_truncated: self.bytes("bootstrap") == [1],
            normalize_rewards: false,
        }
    }

    fn assert_close(&self, key: &str, found: &[f32]) {
        let expected = self.numbers(key);
        assert_eq!(found.len(), expected.len(), "{}.{key}", self.name);
        for (index, (found, expected)) in found.iter().zip(&expected).enumerate() {
            let close = (found - expected).abs() <= 1e-4 * (1.0 + expected.abs());
            assert!(close, "{}.{key}[{index}] is {found}, PyTorch has {expected}", self.name);
        }
    }
}

/// Checks that eight passes over the batch end at PyTorch's parameters, with its metrics.
fn check(name: &'static str, action: ActionSpec, squashed: bool) {
    let case = Case::open(name);
    let observation = ObservationSpec::Vector { len: NUMBERS };
    let spec = Spec { observation, action, horizon_steps: 7 };
    let hidden = vec![HIDDEN];
    let architecture = PolicyArchitecture { hidden, squashed, ..PolicyArchitecture::default() };
    let network = ActorCritic::new(observation, action, &architecture);
    let config = case.config();
    let mut parameters = case.numbers("parameters");
    let schedule = Schedule { run_seed: 1, iteration: 0, learning_rate: config.learning_rate };
    let mut update = PpoUpdate::new(spec, config, network);
    let found = update.update(&mut parameters, &case.batch(), &schedule).unwrap();
    let metrics = [
        found.policy_loss,
        found.value_loss,
        found.entropy,
        found.approximate_kl,
        found.clip_fraction,
        found.gradient_norm,
    ];
    case.assert_close("figures", &metrics.map(|metric| metric as f32));
    case.assert_close("trained", &parameters);
}

#[test]
fn discrete_actions() {
    let action = ActionSpec::Discrete { count: 3 };
    check("categorical_clipped", action, false);
    check("categorical_unclipped", action, false);
}

#[test]
fn normal_actions() {
    let action = ActionSpec::Continuous { len: 2 };
    check("gaussian_clipped", action, false);
    check("gaussian_unclipped", action, false);
}

#[test]
fn squashed_actions() {
    let action = ActionSpec::Continuous { len: 2 };
    check("squashed_clipped", action, true);
    check("squashed_unclipped", action, true);
}
