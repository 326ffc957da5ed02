//! Checks that the schema in the log is `schema/goalward.proto`, and that our messages follow it.
//!
//! `GOALWARD_WRITE_SCHEMA=1 cargo test -p mcap-log --test schema` recompiles the schema.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::path::PathBuf;

use bytes::Bytes;
use mcap_log::Topic;
use mcap_log::topic::{SCENE_SCHEMA, SCHEMA};
use prost::Message;
use prost_reflect::{DescriptorPool, DynamicMessage, ReflectMessage, Value};
use protocol::ending::Ending;
use protocol::messages::{Checkpoint, PolicyUpdate, RewardUpdate, Score};
use protocol::trajectory::{Source, Trajectory, TrajectoryKey};

fn schema_folder() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../schema")
}

#[test]
fn the_committed_schemas_are_what_the_protos_compile_to() {
    for (name, committed) in [("goalward", SCHEMA), ("scene", SCENE_SCHEMA)] {
        let mut compiler = protox::Compiler::new([schema_folder()]).unwrap();
        compiler.include_source_info(false).include_imports(true);
        compiler.open_file(format!("{name}.proto")).unwrap();
        let compiled = compiler.encode_file_descriptor_set();
        if std::env::var_os("GOALWARD_WRITE_SCHEMA").is_some() {
            std::fs::write(schema_folder().join(format!("{name}.bin")), &compiled).unwrap();
        } else {
            assert!(
                compiled == committed,
                "schema/{name}.bin is not what schema/{name}.proto compiles to; \
                 run this test once with GOALWARD_WRITE_SCHEMA=1"
            );
        }
    }
}

/// Decodes our bytes by the schema. Every field of the schema must be there, and nothing else.
fn by_schema(name: &str, bytes: &[u8]) -> DynamicMessage {
    let pool = DescriptorPool::decode(SCHEMA).unwrap();
    let descriptor = pool.get_message_by_name(name).unwrap();
    let message = DynamicMessage::decode(descriptor.clone(), bytes).unwrap();
    assert_eq!(message.unknown_fields().count(), 0, "{name}: fields the schema does not have");
    for field in descriptor.fields() {
        assert!(message.has_field(&field), "{name}: {} is not in our bytes", field.name());
    }
    message
}

fn number(message: &DynamicMessage, field: &str) -> f64 {
    match message.get_field_by_name(field).unwrap().as_ref() {
        Value::U32(number) => f64::from(*number),
        Value::U64(number) => *number as f64,
        Value::F64(number) => *number,
        Value::EnumNumber(number) => f64::from(*number),
        Value::Bool(flag) => f64::from(u8::from(*flag)),
        other => panic!("{field}: expected a number, found {other:?}"),
    }
}

fn numbers(message: &DynamicMessage, field: &str) -> Vec<f32> {
    let value = message.get_field_by_name(field).unwrap();
    value.as_list().unwrap().iter().map(|item| item.as_f32().unwrap()).collect()
}

fn text(message: &DynamicMessage, field: &str) -> String {
    message.get_field_by_name(field).unwrap().as_str().unwrap().to_owned()
}

fn packed(numbers: &[f32]) -> Bytes {
    numbers.iter().flat_map(|number| number.to_le_bytes()).collect()
}

#[test]
fn trajectory() {
    let ours = Trajectory {
        task: "navigation".to_owned(),
        source: Source::Demonstration as i32,
        iteration: 3,
        lane: 4,
        episode: 5,
        policy_version: 6,
        run_seed: 7,
        steps: 8,
        observation_shape: vec![19, 300],
        cells: Bytes::from_static(&[0, 1, 2, 3]),
        values: packed(&[10.0, -0.5, 1e-30]),
        discrete_actions: Bytes::from_static(&[3, 2]),
        continuous_actions: packed(&[11.0, -11.0]),
        log_probs: packed(&[-1.5]),
        environment_rewards: packed(&[0.25, 0.75]),
        ending: Ending::Truncated as i32,
        success: true,
        state_hash: 1 << 40,
        steps_to_goal: 19,
        full_hash: 1 << 41,
    };
    let theirs = by_schema("goalward.v1.Trajectory", &ours.encode_to_vec());
    assert_eq!(text(&theirs, "task"), "navigation");
    let named = ["source", "iteration", "lane", "episode", "policy_version", "run_seed", "steps"];
    let found: Vec<f64> = named.iter().map(|field| number(&theirs, field)).collect();
    assert_eq!(found, [2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]);
    let shape = theirs.get_field_by_name("observation_shape").unwrap();
    let shape: Vec<_> = shape.as_list().unwrap().iter().map(|side| side.as_u32()).collect();
    assert_eq!(shape, [Some(19), Some(300)]);
    for (field, bytes) in [("cells", &ours.cells), ("discrete_actions", &ours.discrete_actions)] {
        assert_eq!(theirs.get_field_by_name(field).unwrap().as_bytes(), Some(bytes), "{field}");
    }
    assert_eq!(numbers(&theirs, "values"), [10.0, -0.5, 1e-30]);
    assert_eq!(numbers(&theirs, "continuous_actions"), [11.0, -11.0]);
    assert_eq!(numbers(&theirs, "log_probs"), [-1.5]);
    assert_eq!(numbers(&theirs, "environment_rewards"), [0.25, 0.75]);
    assert_eq!(number(&theirs, "ending"), 1.0);
    assert_eq!(number(&theirs, "success"), 1.0);
    assert_eq!(number(&theirs, "state_hash"), (1u64 << 40) as f64);
    assert_eq!(number(&theirs, "steps_to_goal"), 19.0);
    assert_eq!(number(&theirs, "full_hash"), (1u64 << 41) as f64);
}

/// A trajectory whose arrays are declared as numbers, as others would declare them.
#[derive(Clone, PartialEq, Message)]
struct PlainTrajectory {
    #[prost(float, repeated, tag = "11")]
    values: Vec<f32>,
    #[prost(float, repeated, tag = "14")]
    log_probs: Vec<f32>,
}

#[test]
fn arrays_declared_as_bytes_are_the_same_bytes_as_lists_of_numbers() {
    let (values, log_probs) = (vec![1.0, f32::MIN_POSITIVE, -0.0, 3.5e30], vec![-2.25; 100]);
    let ours = Trajectory {
        values: packed(&values),
        log_probs: packed(&log_probs),
        ..Trajectory::default()
    };
    let plain = PlainTrajectory { values, log_probs };
    assert_eq!(ours.encode_to_vec(), plain.encode_to_vec());
    assert_eq!(Trajectory::decode(&*plain.encode_to_vec()).unwrap(), ours);
}

#[test]
fn score() {
    let ours = Score {
        iteration: 1,
        lane: 2,
        episode: 3,
        model_version: 4,
        rewards: vec![0.5, -0.5],
        proximity: vec![0.25, 0.5, 0.75],
        uncertainty: vec![0.125],
    };
    let theirs = by_schema(Topic::Score.schema(), &ours.encode_to_vec());
    let named = ["iteration", "lane", "episode", "model_version"];
    assert_eq!(named.map(|field| number(&theirs, field)), [1.0, 2.0, 3.0, 4.0]);
    assert_eq!(numbers(&theirs, "rewards"), ours.rewards);
    assert_eq!(numbers(&theirs, "proximity"), ours.proximity);
    assert_eq!(numbers(&theirs, "uncertainty"), ours.uncertainty);
}

#[test]
fn policy_update() {
    let ours = PolicyUpdate {
        iteration: 1,
        policy_version: 2,
        environment_steps: 3,
        episodes: 4,
        consumed: vec![TrajectoryKey { lane: 5, episode: 6, hash: 7 }],
        minibatch_seed: 6,
        learning_rate: 7.0,
        policy_loss: 8.0,
        value_loss: 9.0,
        entropy: 10.0,
        approximate_kl: 11.0,
        clip_fraction: 12.0,
        gradient_norm: 13.0,
        success_rate: 14.0,
        mean_reward: 15.0,
        mean_proximity: 16.0,
        mean_uncertainty: 17.0,
        mean_episode_steps: 18.0,
        weights_sha256: "19".to_owned(),
        rollout_s: 20.0,
        scoring_s: 21.0,
        update_s: 22.0,
        held_out_loss: 23.0,
        wall_s: 24.0,
        processor_s: 25.0,
    };
    let theirs = by_schema(Topic::PolicyUpdate.schema(), &ours.encode_to_vec());
    // Every number above is the tag of its field.
    for field in theirs.descriptor().fields() {
        match field.name() {
            "consumed" => {
                let value = theirs.get_field(&field);
                let key = value.as_list().unwrap()[0].as_message().unwrap().clone();
                assert_eq!(key.unknown_fields().count(), 0);
                let named = ["lane", "episode", "hash"];
                assert_eq!(named.map(|field| number(&key, field)), [5.0, 6.0, 7.0]);
            }
            "weights_sha256" => assert_eq!(text(&theirs, "weights_sha256"), "19"),
            name => assert_eq!(number(&theirs, name), f64::from(field.number()), "{name}"),
        }
    }
    assert_eq!(number(&theirs, "environment_steps"), 3.0);
    assert_eq!(number(&theirs, "mean_episode_steps"), 18.0);
    assert_eq!(number(&theirs, "update_s"), 22.0);
}

#[test]
fn reward_update() {
    let ours = RewardUpdate {
        iteration: 1,
        model_version: 2,
        gradient_steps: 3,
        demonstration_loss: 4.0,
        agent_loss: 5.0,
        weights_sha256: "6".to_owned(),
        experience: 7,
        seconds: 8.0,
        processor_s: 9.0,
    };
    let theirs = by_schema(Topic::RewardUpdate.schema(), &ours.encode_to_vec());
    let named = ["iteration", "model_version", "gradient_steps", "demonstration_loss"];
    assert_eq!(named.map(|field| number(&theirs, field)), [1.0, 2.0, 3.0, 4.0]);
    let named = ["agent_loss", "experience", "seconds", "processor_s"];
    assert_eq!(named.map(|field| number(&theirs, field)), [5.0, 7.0, 8.0, 9.0]);
    assert_eq!(text(&theirs, "weights_sha256"), "6");
}

#[test]
fn checkpoint() {
    let ours = Checkpoint {
        iteration: 1,
        path: "checkpoints/1".to_owned(),
        policy_sha256: "3".to_owned(),
        proximity_sha256: "4".to_owned(),
        policy_file_sha256: "5".to_owned(),
        learner_file_sha256: "6".to_owned(),
        proximity_file_sha256: "7".to_owned(),
    };
    let theirs = by_schema(Topic::Checkpoint.schema(), &ours.encode_to_vec());
    assert_eq!(number(&theirs, "iteration"), 1.0);
    let named = ["path", "policy_sha256", "proximity_sha256"];
    assert_eq!(named.map(|field| text(&theirs, field)), ["checkpoints/1", "3", "4"]);
    let named = ["policy_file_sha256", "learner_file_sha256", "proximity_file_sha256"];
    assert_eq!(named.map(|field| text(&theirs, field)), ["5", "6", "7"]);
}
