//! Tests of learned models, and shared fixtures: a configuration, and a corridor with the goal at its end.

use std::time::Duration;

use bytes::Bytes;
use protocol::messages::RewardUpdate;
use protocol::task::{ActionSpec, ObservationSpec, Spec, write_floats};
use protocol::trajectory::{Encoded, Source, Trajectory};
use run::config::{
    Discounting, RewardConfig, RewardForm, RewardInput, RewardModelKind, UpdateOrder,
};
use run::learning_rate::LearningRate;

use crate::model::{Discriminator, GoalProximity, Learned, Objective, Ranking, RewardModel, Slice};

/// Returns the paper's reward with small networks.
pub(crate) fn config() -> RewardConfig {
    RewardConfig {
        model: RewardModelKind::named("proximity").unwrap(),
        input: RewardInput::State,
        form: RewardForm::Difference,
        final_bonus: true,
        uncertainty: 0.1,
        offset: 0.0,
        gradient_penalty: 0.0,
        agent_weight: 1.0,
        segments: 1,
        discounting: Discounting::Linear,
        delta: 0.1,
        ensemble: 5,
        bootstrap: false,
        prior: 0.0,
        weight_decay: 0.0,
        convolution_channels: vec![4, 4, 4],
        convolution_kernel: 2,
        pool: 2,
        features: 8,
        hidden: vec![16, 16],
        normalize_observations: false,
        learning_rate: 0.003,
        learning_rate_decay: false,
        decay_steps: 0,
        pretraining_epochs: 200,
        batch: 11,
        samples: 11,
        experience: 100,
        experience_after_goal: false,
        arrival: 0.0,
        order: UpdateOrder::ScoreFirst,
    }
}

/// A corridor: an observation is a place and a row, and the goal is at place 1. An action is 0 or 1.
pub(crate) const CORRIDOR: Spec = Spec {
    observation: ObservationSpec::Vector { len: 2 },
    action: ActionSpec::Discrete { count: 2 },
    horizon_steps: 10,
};

/// The corridor as a task file.
pub(crate) const CORRIDOR_FILE: &str = "[task]\nname = \"corridor\"\nobservation.vector.len = 2\n\
                                        action.discrete.count = 2\nhorizon_steps = 10\n";

/// Returns a walk of ten steps from place 0 to place 1 in a row.
pub(crate) fn walk(row: f32, source: Source) -> Trajectory {
    let mut values = vec![0; 11 * 8];
    write_floats((0..11).flat_map(|step| [step as f32 / 10.0, row]), &mut values);
    let log_probs = if source == Source::Demonstration { 0 } else { 40 };
    Trajectory {
        task: "navigation".to_owned(),
        source: source as i32,
        steps: 10,
        observation_shape: vec![2],
        values: values.into(),
        discrete_actions: Bytes::from(vec![0; 10]),
        log_probs: vec![0; log_probs].into(),
        environment_rewards: vec![0; 40].into(),
        success: true,
        steps_to_goal: 10,
        ..Trajectory::default()
    }
}

/// Returns the walk from place 1 to place 0.
pub(crate) fn walk_back(row: f32, source: Source) -> Trajectory {
    let forth = walk(row, source);
    let back: Vec<u8> = forth.values.chunks_exact(8).rev().flatten().copied().collect();
    Trajectory { values: back.into(), ..forth }
}

/// Creates a model with one demonstration, a walk in row 0.
pub(crate) fn learned<O: Objective>(config: &RewardConfig, threads: usize) -> Learned<O> {
    let threads = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let rate = LearningRate { first: config.learning_rate, iterations: Some(100) };
    Learned::new(&CORRIDOR, config, rate, 1, &[walk(0.0, Source::Demonstration)], threads)
}

/// Trains a model offline to the end.
pub(crate) fn pretrained(model: &mut impl RewardModel) -> RewardUpdate {
    match model.pretrain(Duration::MAX).unwrap() {
        Slice::Done(update) => update,
        Slice::UnderWay(standing) => panic!("expected the end, found {standing:?}"),
    }
}

/// Checks that two models of the same objective learn the same bits when one of them runs on three threads and
/// starts from the other's checkpoint.
pub(crate) fn assert_reproducible<O: Objective>(config: &RewardConfig) {
    let batch = [Encoded::encode(walk(1.0, Source::Training))];
    let mut one: Learned<O> = learned(config, 1);
    pretrained(&mut one);
    one.improve(0, &batch).unwrap();
    let mut other: Learned<O> = learned(config, 3);
    other.restore(&one.save()).unwrap();
    for iteration in 1..4 {
        let (of_one, of_other) =
            (one.improve(iteration, &batch).unwrap(), other.improve(iteration, &batch).unwrap());
        assert!(of_one.gradient_steps > 0);
        assert_eq!(of_one.weights_sha256, of_other.weights_sha256);
    }
    // More rows than a thread scores at once.
    let batch: Vec<Encoded> =
        (0u8..20).map(|row| Encoded::encode(walk(row.into(), Source::Training))).collect();
    assert_eq!(one.score(4, &batch), other.score(4, &batch));
}

fn model(threads: usize) -> Learned<GoalProximity> {
    learned(&config(), threads)
}

pub(crate) fn place(place: f32, row: f32) -> Vec<u8> {
    let mut bytes = vec![0; 8];
    write_floats([place, row], &mut bytes);
    bytes
}

#[test]
fn offline_training_fits_the_labels_and_is_sure_only_where_it_was_shown() {
    let mut model = model(2);
    let update = pretrained(&mut model);
    assert_eq!(update.gradient_steps, 200);
    assert!(update.weights_sha256 == model.sha256() && update.model_version == 1);
    for tenths in [0, 3, 7, 10] {
        let estimates = model.estimate(&place(tenths as f32 / 10.0, 0.0)).unwrap();
        let expected = tenths as f32 / 10.0;
        assert!((estimates.proximity[0] - expected).abs() < 0.1, "{expected}: {estimates:?}");
    }
    let shown = model.estimate(&place(0.5, 0.0)).unwrap().uncertainty[0];
    let never_shown = model.estimate(&place(0.5, 5.0)).unwrap().uncertainty[0];
    assert!(never_shown > 3.0 * shown, "shown {shown}, never shown {never_shown}");
}

/// Returns the proximity of a place that only the agent visits, before and after eighty updates, and the model.
fn visited(agent_weight: f64) -> ([f32; 2], Learned<GoalProximity>) {
    let mut model: Learned<GoalProximity> = learned(&RewardConfig { agent_weight, ..config() }, 2);
    pretrained(&mut model);
    let elsewhere =
        |model: &Learned<GoalProximity>| model.estimate(&place(0.9, 1.0)).unwrap().proximity[0];
    let before = elsewhere(&model);
    let batch = [Encoded::encode(walk(1.0, Source::Training))];
    for iteration in 0..80 {
        assert_eq!(model.improve(iteration, &batch).unwrap().gradient_steps, 1);
    }
    ([before, elsewhere(&model)], model)
}

#[test]
fn online_training_lowers_the_proximity_of_what_only_the_agent_visits() {
    let ([before, after], mut model) = visited(1.0);
    assert!(before > 0.4 && after < 0.2, "before {before}, after {after}");
    assert!(model.estimate(&place(0.9, 0.0)).unwrap().proximity[0] > 0.6);
    let batch = [Encoded::encode(walk(1.0, Source::Training))];
    assert_eq!(model.improve(80, &batch).unwrap().experience, 100);
}

#[test]
fn the_weight_of_the_agents_loss_says_by_how_much() {
    let [_, whole] = visited(1.0).0;
    let [before, gentle] = visited(0.1).0;
    let [_, none] = visited(0.0).0;
    assert!(whole + 0.1 < gentle && gentle + 0.1 < none, "{whole}, {gentle}, {none} of {before}");
}

#[test]
fn what_the_agent_saw_after_the_goal_is_experience_only_where_it_is_asked_for() {
    let walk = Trajectory { steps_to_goal: 6, ..walk(1.0, Source::Training) };
    let batch = [Encoded::encode(walk)];
    for (experience_after_goal, expected) in [(false, 7), (true, 11)] {
        let mut model: Learned<GoalProximity> =
            learned(&RewardConfig { experience_after_goal, ..config() }, 1);
        assert_eq!(model.improve(0, &batch).unwrap().experience, expected);
    }
}

#[test]
fn what_the_agent_saw_after_its_estimated_arrival_is_no_experience() {
    // The model estimates 0, 0.1, ..., 1 along this walk, and keeps it up to the share of the highest.
    let batch = [Encoded::encode(walk(0.0, Source::Training))];
    for (arrival, expected) in [(0.0, 11), (0.45, 6), (0.75, 9), (1.0, 11)] {
        let mut model: Learned<GoalProximity> =
            learned(&RewardConfig { arrival, experience_after_goal: true, ..config() }, 2);
        pretrained(&mut model);
        assert_eq!(model.improve(0, &batch).unwrap().experience, expected, "{arrival}");
    }
}

#[test]
fn nothing_of_the_agent_is_kept_that_nobody_learns_from() {
    let batch = [Encoded::encode(walk(1.0, Source::Training))];
    let mut model: Learned<GoalProximity> = learned(&RewardConfig { samples: 0, ..config() }, 1);
    let update = model.improve(0, &batch).unwrap();
    assert_eq!((update.gradient_steps, update.experience), (0, 0));
    assert!(model.save().u8("experience").unwrap().is_empty());
    // Checkpoints of older builds contain the agent's rows.
    let mut older = self::model(1);
    older.improve(0, &batch).unwrap();
    model.restore(&older.save()).unwrap();
    assert!(model.save().u8("experience").unwrap().is_empty());
}

#[test]
fn of_a_batch_that_is_larger_than_the_buffer_the_last_lanes_stay() {
    let of_lane = |lane: u8| {
        let walk = walk(f32::from(lane), Source::Training);
        Encoded::encode(Trajectory { lane: u64::from(lane), ..walk })
    };
    let batch = [0, 1].map(of_lane);
    let config = RewardConfig { experience: 11, ..config() };
    let mut model: Learned<GoalProximity> = learned(&config, 1);
    model.improve(0, &batch).unwrap();
    let kept = model.save().u8("experience").unwrap();
    assert_eq!(kept, batch[1].trajectory.observations());
}

/// Checks that `reward.samples` and `reward.batch` mean the same for every model: full batches of its rows.
#[test]
fn every_model_trains_on_what_rows_there_are() {
    fn steps<O: Objective>(samples: usize) -> u64 {
        let config = RewardConfig { form: RewardForm::Airl, samples, batch: 2, ..config() };
        // Ten steps, eleven observations.
        let batch = [Encoded::encode(walk(1.0, Source::Training))];
        learned::<O>(&config, 1).improve(0, &batch).unwrap().gradient_steps
    }
    for (samples, expected) in [(4, 2), (40, 5), (0, 0)] {
        let found = [steps::<GoalProximity>, steps::<Ranking>, steps::<Discriminator>]
            .map(|of| of(samples));
        assert_eq!(found, [expected; 3], "{samples} samples");
    }
}

#[test]
fn online_training_ends_when_the_learning_rate_is_zero() {
    let mut model = model(1);
    let batch = [Encoded::encode(walk(1.0, Source::Training))];
    let (last, after) = (model.improve(99, &batch).unwrap(), model.improve(100, &batch).unwrap());
    assert_eq!((last.gradient_steps, after.gradient_steps), (1, 0));
    assert_eq!(last.weights_sha256, after.weights_sha256);
}

#[test]
fn threads_change_no_bit_and_a_restored_model_goes_on_alike() {
    assert_reproducible::<GoalProximity>(&config());
    // With actions the walk has ten rows.
    let actions = RewardConfig { input: RewardInput::StateAction, batch: 10, ..config() };
    assert_reproducible::<GoalProximity>(&actions);
}

#[test]
fn proximity_with_actions_depends_on_the_action_and_needs_one() {
    let config =
        RewardConfig { input: RewardInput::StateAction, uncertainty: 0.0, batch: 10, ..config() };
    let mut model: Learned<GoalProximity> = learned(&config, 2);
    pretrained(&mut model);
    let right = walk(0.0, Source::Training);
    let wrong = Trajectory { discrete_actions: vec![1; 10].into(), ..right.clone() };
    let batch = [right, wrong].map(Encoded::encode);
    for iteration in 0..80 {
        model.improve(iteration, &batch[1..]).unwrap();
    }
    let scores = model.score(80, &batch);
    assert_eq!((scores[0].proximity.len(), scores[0].rewards.len()), (11, 10));
    let [right, wrong] = [0, 1].map(|at: usize| scores[at].proximity[8]);
    assert!(right > wrong + 0.3, "right {right}, wrong {wrong}");
    let message = model.estimate(&place(0.5, 0.0)).unwrap_err().to_string();
    assert!(message.contains("single states") && message.contains("states and actions"));
}

/// If the last observation had a row without an action, that alone would mark the end of an episode.
#[test]
fn with_actions_the_end_of_an_episode_changes_no_proximity() {
    let config = RewardConfig { input: RewardInput::StateAction, batch: 10, ..config() };
    let mut model: Learned<GoalProximity> = learned(&config, 1);
    pretrained(&mut model);
    let whole = walk(0.0, Source::Training);
    let cut = Trajectory {
        steps: 5,
        values: whole.values.slice(..6 * 8),
        discrete_actions: whole.discrete_actions.slice(..5),
        log_probs: whole.log_probs.slice(..20),
        environment_rewards: whole.environment_rewards.slice(..20),
        success: false,
        steps_to_goal: 0,
        ..whole.clone()
    };
    let scores = model.score(0, &[whole, cut].map(Encoded::encode));
    assert_eq!(scores[0].proximity[..6], scores[1].proximity);
    assert_eq!(scores[0].proximity[0], scores[0].proximity[1], "nothing led to the first");
}

#[test]
fn a_foreign_checkpoint_is_refused_with_the_array_that_differs() {
    let mut tensors = model(1).save();
    tensors.put_f32("member0.parameters", [1.0]);
    let message = model(1).restore(&tensors).unwrap_err();
    assert!(message.contains("member0.parameters") && message.contains("found 1"), "{message}");
    let mut tensors = model(1).save();
    tensors.put_u8("experience", [0; 7]);
    let message = model(1).restore(&tensors).unwrap_err();
    let expected = "array `experience`: expected whole rows of 8 bytes, found 7 bytes";
    assert_eq!(message, expected);
}

/// Trains offline in slices of one step, and restores the model from its saved state after every seventh step.
#[test]
fn slices_of_offline_training_change_no_bit() {
    let expected = pretrained(&mut model(1));
    let mut model = model(2);
    let mut steps = 0;
    let update = loop {
        match model.pretrain(Duration::from_nanos(1)).unwrap() {
            Slice::Done(update) => break update,
            Slice::UnderWay(standing) => {
                assert!((standing.done, standing.total) >= (steps, 200), "{standing:?}");
                steps = standing.done;
            }
        }
        if steps % 7 == 0 {
            let saved = model.save();
            model = self::model(1);
            model.restore(&saved).unwrap();
        }
    };
    assert!(steps > 100, "expected it to be cut into slices");
    let RewardUpdate { gradient_steps, demonstration_loss, ref weights_sha256, .. } = update;
    assert_eq!(gradient_steps, expected.gradient_steps);
    assert_eq!(demonstration_loss, expected.demonstration_loss);
    assert_eq!(*weights_sha256, expected.weights_sha256);
    assert!(!model.save().has("offline.done"), "a trained model has nothing left of it");
}

#[test]
fn what_diverges_is_refused_with_its_minibatch() {
    let config = RewardConfig { learning_rate: 1e30, ..config() };
    let mut model: Learned<GoalProximity> = learned(&config, 2);
    let message = model.pretrain(Duration::MAX).unwrap_err().to_string();
    assert!(message.contains("reward model diverged: minibatch"), "{message}");
    assert!(message.contains("member 0"), "{message}");
    let mut model: Learned<GoalProximity> = learned(&config, 2);
    let batch = [Encoded::encode(walk(1.0, Source::Training))];
    let improved: Result<Vec<_>, _> =
        (0..3).map(|iteration| model.improve(iteration, &batch)).collect();
    let message = improved.unwrap_err().to_string();
    assert!(message.contains("minibatch 1, member"), "{message}");
}
