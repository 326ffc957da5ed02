//! What the tests of this crate share: a configuration, and a corridor to be close to the end of.

use bytes::Bytes;
use protocol::config::{
    Discounting, RewardConfig, RewardForm, RewardInput, RewardModel as Model, UpdateOrder,
};
use protocol::learning_rate::LearningRate;
use protocol::task::{ActionSpec, ObservationSpec, Spec, Task, write_floats};
use protocol::trajectory::{Encoded, Source, Trajectory};

use crate::demonstrations::Demonstrations;
use crate::model::{GoalProximity, RewardModel};

/// The paper's reward over small networks.
pub(crate) fn config() -> RewardConfig {
    RewardConfig {
        model: Model::Proximity,
        input: RewardInput::State,
        form: RewardForm::Difference,
        final_bonus: true,
        uncertainty: 0.1,
        gradient_penalty: 0.0,
        discounting: Discounting::Linear,
        delta: 0.1,
        ensemble: 5,
        convolution_channels: [4, 4, 4],
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
        order: UpdateOrder::ScoreFirst,
    }
}

/// A corridor: the observation is a place and a row, and the goal is place 1.
const CORRIDOR: Spec = Spec {
    task: Task::Navigation,
    observation: ObservationSpec::Vector { len: 2 },
    action: ActionSpec::Discrete { count: 2 },
    horizon_steps: 10,
};

/// A walk of ten steps from place 0 to place 1 in a row.
fn walk(row: f32, source: Source) -> Trajectory {
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
        success: true,
        steps_to_goal: 10,
        ..Trajectory::default()
    }
}

fn model(threads: usize) -> GoalProximity {
    let demonstrations = Demonstrations::of(&[walk(0.0, Source::Demonstration)], &config());
    let threads = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let rate = LearningRate { first: 0.003, iterations: Some(100) };
    GoalProximity::new(&CORRIDOR, &config(), rate, 1, demonstrations, threads)
}

fn place(place: f32, row: f32) -> Vec<u8> {
    let mut bytes = vec![0; 8];
    write_floats([place, row], &mut bytes);
    bytes
}

#[test]
fn offline_training_fits_the_labels_and_is_sure_only_where_it_was_shown() {
    let mut model = model(2);
    let update = model.pretrain();
    assert_eq!(update.gradient_steps, 200);
    assert!(update.weights_sha256 == model.sha256() && update.model_version == 1);
    for tenths in [0, 3, 7, 10] {
        let estimates = model.estimate(&place(tenths as f32 / 10.0, 0.0));
        let expected = tenths as f32 / 10.0;
        assert!((estimates.proximity[0] - expected).abs() < 0.1, "{expected}: {estimates:?}");
    }
    let shown = model.estimate(&place(0.5, 0.0)).uncertainty[0];
    let never_shown = model.estimate(&place(0.5, 5.0)).uncertainty[0];
    assert!(never_shown > 3.0 * shown, "shown {shown}, never shown {never_shown}");
}

#[test]
fn online_training_lowers_the_proximity_of_what_only_the_agent_visits() {
    let mut model = model(2);
    model.pretrain();
    let elsewhere = place(0.9, 1.0);
    let before = model.estimate(&elsewhere).proximity[0];
    let batch = [Encoded::encode(walk(1.0, Source::Training))];
    let mut last = None;
    for iteration in 0..80 {
        last = Some(model.improve(iteration, &batch));
    }
    let after = model.estimate(&elsewhere).proximity[0];
    assert!(before > 0.4 && after < 0.2, "before {before}, after {after}");
    assert!(model.estimate(&place(0.9, 0.0)).proximity[0] > 0.6);
    assert_eq!(last.unwrap().experience, 100);
}

#[test]
fn online_training_ends_when_the_learning_rate_is_zero() {
    let mut model = model(1);
    let batch = [Encoded::encode(walk(1.0, Source::Training))];
    let (last, after) = (model.improve(99, &batch), model.improve(100, &batch));
    assert_eq!((last.gradient_steps, after.gradient_steps), (1, 0));
    assert_eq!(last.weights_sha256, after.weights_sha256);
}

#[test]
fn threads_change_no_bit_and_a_restored_model_goes_on_alike() {
    let batch = [Encoded::encode(walk(1.0, Source::Training))];
    let mut one = model(1);
    one.pretrain();
    let mut other = model(3);
    other.restore(&one.save()).unwrap();
    for iteration in 0..3 {
        let (of_one, of_other) = (one.improve(iteration, &batch), other.improve(iteration, &batch));
        assert_eq!(of_one.weights_sha256, of_other.weights_sha256);
    }
    assert_eq!(one.score(3, &batch), other.score(3, &batch));
}

#[test]
fn a_foreign_checkpoint_is_refused_with_the_array_that_differs() {
    let mut tensors = model(1).save();
    tensors.put_f32("member0.parameters", [1.0]);
    let message = model(1).restore(&tensors).unwrap_err();
    assert!(message.contains("member0.parameters") && message.contains("found 1"), "{message}");
}
