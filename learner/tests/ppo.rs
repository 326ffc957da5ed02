//! The policy update as a whole: it solves a bandit, and the number of threads changes no bit of it.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use learner::algorithm::Schedule;
use learner::algorithm::ppo::PpoUpdate;
use learner::batch::{EpisodeRows, RolloutBatch};
use networks::{ActorCritic, Batch, PolicyArchitecture, PolicyWorkspace};
use proptest::prelude::*;
use protocol::seed::{Purpose, stream};
use protocol::task::{ActionSpec, ObservationSpec, Spec};
use protocol::tensors::Tensors;
use run::config::PpoConfig;

/// One step per episode; the second of three actions earns 1.
const BANDIT: Spec = Spec {
    observation: ObservationSpec::Vector { len: 1 },
    action: ActionSpec::Discrete { count: 3 },
    horizon_steps: 1,
};

const ROWS: usize = 600;

fn config() -> PpoConfig {
    PpoConfig {
        learning_rate: 0.003,
        learning_rate_decay: false,
        decay_steps: 0,
        adam_epsilon: 1e-5,
        gamma: 0.99,
        gae_lambda: 0.95,
        clip: 0.2,
        value_clip: 0.2,
        value_coefficient: 0.5,
        entropy_coefficient: 0.0,
        epochs: 4,
        target_kl: 0.0,
        minibatches: 2,
        max_gradient_norm: 0.5,
        bootstrap_truncated: false,
        normalize_rewards: false,
    }
}

fn network() -> ActorCritic {
    let architecture = PolicyArchitecture { hidden: vec![16], ..PolicyArchitecture::default() };
    ActorCritic::new(BANDIT.observation, BANDIT.action, &architecture)
}

/// Samples a batch from the policy.
fn batch(network: &ActorCritic, parameters: &[f32], iteration: u64) -> RolloutBatch {
    let mut draws = stream(1, Purpose::TrainingActions, iteration, 0);
    let prepared = network.prepare(parameters);
    let observations = 1.0f32.to_le_bytes().repeat(ROWS);
    let mut workspace = PolicyWorkspace::default();
    let outputs = network.act(&prepared, Batch::new(&observations), &mut workspace);
    let mut batch = RolloutBatch { observations: observations.clone(), ..RolloutBatch::default() };
    for row in outputs.as_slice().chunks_exact(outputs.nrows()) {
        let mut action = [0];
        batch.log_probs.push(network.distribution().sample(row, &mut draws, &mut action));
        batch.actions.push(action[0]);
        batch.rewards.push(if action[0] == 1 { 1.0 } else { 0.0 });
        let last_observation = 0.0f32.to_le_bytes().to_vec();
        batch.episodes.push(EpisodeRows { steps: 1, last_observation, truncated: false });
    }
    batch
}

/// Trains on `threads` threads; returns the parameters and the last mean reward.
fn train(threads: usize, iterations: u64) -> (Vec<f32>, f32) {
    train_with(config(), threads, iterations)
}

fn train_with(config: PpoConfig, threads: usize, iterations: u64) -> (Vec<f32>, f32) {
    let network = network();
    let mut parameters = network.initial_parameters(&mut stream(1, Purpose::PolicyWeights, 0, 0));
    let threads = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
    let mut ppo = PpoUpdate::new(BANDIT, config, network.clone());
    let mut mean = 0.0;
    for iteration in 0..iterations {
        let batch = batch(&network, &parameters, iteration);
        mean = batch.rewards.iter().sum::<f32>() / ROWS as f32;
        let schedule = Schedule { run_seed: 1, iteration, learning_rate: 0.003 };
        let metrics = threads.install(|| ppo.update(&mut parameters, &batch, &schedule)).unwrap();
        assert!(metrics.gradient_norm.is_finite() && metrics.entropy >= 0.0);
    }
    (parameters, mean)
}

#[test]
fn the_better_arm_is_found() {
    let (_, mean) = train(2, 25);
    assert!(mean > 0.9, "mean reward {mean} after 25 updates, 0.33 before");
}

#[test]
fn no_pass_follows_one_beyond_the_target_divergence() {
    let after = |epochs, target_kl| {
        let config = PpoConfig { epochs, target_kl, ..config() };
        train_with(config, 1, 1).0
    };
    // At the second minibatch of the first pass, the policy already differs from the one that acted.
    assert_eq!(after(4, 1e-12), after(1, 0.0));
    assert_eq!(after(4, 1e3), after(4, 0.0));
    assert_ne!(after(4, 1e-12), after(4, 0.0));
}

#[test]
fn every_row_is_learned_from_where_there_are_fewer_than_minibatches() {
    let network = network();
    let first = network.initial_parameters(&mut stream(1, Purpose::PolicyWeights, 0, 0));
    let few = |rows: usize| {
        let mut few = batch(&network, &first, 0);
        few.observations.truncate(4 * rows);
        few.actions.truncate(rows);
        few.log_probs.truncate(rows);
        few.rewards.truncate(rows);
        few.episodes.truncate(rows);
        few
    };
    for rows in [1, 2, 3] {
        let config = PpoConfig { minibatches: 8, ..config() };
        let mut ppo = PpoUpdate::new(BANDIT, config, network.clone());
        let mut parameters = first.clone();
        let schedule = Schedule { run_seed: 1, iteration: 0, learning_rate: 0.003 };
        let updated = ppo.update(&mut parameters, &few(rows), &schedule);
        let metrics = updated.expect("finite numbers");
        let mut saved = Tensors::default();
        ppo.save(&mut saved);
        let steps = saved.u64("adam.step").unwrap();
        assert_eq!(steps, [4 * rows as u64], "a step for every row and epoch");
        assert!(metrics.value_loss.is_finite() && parameters != first, "{rows} rows");
    }
}

#[test]
fn threads_change_no_bit() {
    let bits = |threads| {
        let (parameters, _) = train(threads, 3);
        parameters.into_iter().map(f32::to_bits).collect::<Vec<_>>()
    };
    let one = bits(1);
    assert_eq!(one, bits(2));
    assert_eq!(one, bits(5));
}

/// Generates numbers of every magnitude, many of them larger than any in training.
fn number() -> impl Strategy<Value = f32> {
    let wide = (any::<f32>(), -38.0..38.0_f32)
        .prop_map(|(sign, power)| libm::powf(10.0, power).copysign(sign));
    prop_oneof![-2.0..2.0_f32, wide, Just(f32::MAX), Just(f32::MIN), Just(0.0_f32)]
}

proptest! {
    /// Whatever the rewards and the ratios (set through the log-probabilities that acted) are, an update ends
    /// with finite numbers, or is refused with the loss and the minibatch.
    #[test]
    fn no_reward_or_ratio_makes_numbers_that_are_none(
        rewards in prop::collection::vec(number(), 4..24),
        differences in prop::collection::vec(number(), 24),
        clip in prop_oneof![Just(0.0), Just(0.2)],
    ) {
        let network = network();
        let mut parameters =
            network.initial_parameters(&mut stream(1, Purpose::PolicyWeights, 0, 0));
        let config = PpoConfig { value_clip: clip, minibatches: 2, epochs: 2, ..config() };
        let mut ppo = PpoUpdate::new(BANDIT, config, network.clone());
        let mut batch = batch(&network, &parameters, 0);
        batch.observations.truncate(4 * rewards.len());
        batch.actions.truncate(rewards.len());
        batch.log_probs.truncate(rewards.len());
        batch.episodes.truncate(rewards.len());
        for (log_prob, difference) in batch.log_probs.iter_mut().zip(differences) {
            *log_prob = (*log_prob + difference).clamp(f32::MIN, f32::MAX);
        }
        batch.rewards = rewards;
        let schedule = Schedule { run_seed: 1, iteration: 0, learning_rate: 0.003 };
        match ppo.update(&mut parameters, &batch, &schedule) {
            Ok(metrics) => {
                let mut saved = Tensors::default();
                ppo.save(&mut saved);
                prop_assert_eq!(saved.expect_finite(), Ok(()));
                prop_assert!(parameters.iter().all(|number| number.is_finite()));
                prop_assert!(metrics.expect_finite("").is_ok(), "{metrics:?}");
            }
            Err(refused) => {
                let message = refused.to_string();
                prop_assert!(message.contains("the learner diverged"), "{message}");
                prop_assert!(message.contains("epoch ") && message.contains("minibatch "));
            }
        }
    }
}

/// If only the ratio overflows, and is clipped, there is nothing to refuse.
#[test]
fn a_ratio_beyond_all_numbers_is_clipped() {
    let network = network();
    let mut parameters = network.initial_parameters(&mut stream(1, Purpose::PolicyWeights, 0, 0));
    let before = parameters.clone();
    let mut ppo = PpoUpdate::new(BANDIT, config(), network.clone());
    let mut batch = batch(&network, &parameters, 0);
    let better =
        batch.rewards.iter().zip(&mut batch.log_probs).filter(|(reward, _)| **reward > 0.0);
    better.for_each(|(_, log_prob)| *log_prob = -1000.0);
    let schedule = Schedule { run_seed: 1, iteration: 0, learning_rate: 0.003 };
    let metrics = ppo.update(&mut parameters, &batch, &schedule).unwrap();
    assert!(metrics.approximate_kl > 1e30 && metrics.approximate_kl.is_finite(), "{metrics:?}");
    assert!(parameters != before && parameters.iter().all(|number| number.is_finite()));
}
