//! Requirements on every environment, whatever its task: the same stream gives the same episode, observations fit the
//! spec, episodes end by the horizon, refusals change nothing, and our own code allocates nothing while an episode
//! runs.

use environments::{BUILT_IN, Environment, EnvironmentError, Setting, Step, create};
use protocol::ending::Ending;
use protocol::seed::{Purpose, Stream, stream};
use protocol::task::{ActionSpec, ObservationSpec, Spec, floats, write_floats};
use rand::RngExt;

/// A recorded episode for comparison: observations with state hashes, and steps.
#[derive(Debug, PartialEq)]
struct Episode {
    states: Vec<(Vec<u8>, u64)>,
    steps: Vec<Step>,
}

fn tasks() -> impl Iterator<Item = &'static str> {
    BUILT_IN.iter().map(|task| task.name)
}

fn open(task: &str) -> Box<dyn Environment> {
    create(task, &Setting::default()).expect("every task has the default setting")
}

fn streams(episode: u64) -> (Stream, Stream) {
    (
        stream(1, Purpose::TrainingEpisode, 0, episode),
        stream(1, Purpose::TrainingActions, 0, episode),
    )
}

fn draw_action(spec: &Spec, stream: &mut Stream, action: &mut [u8]) {
    match spec.action {
        ActionSpec::Discrete { count } => action[0] = stream.random_range(0..count as u32) as u8,
        ActionSpec::Continuous { len } => {
            write_floats((0..len).map(|_| stream.random_range(-1.0f32..1.0)), action);
        }
    }
}

/// Takes random actions until the episode ends, at most `steps_max`.
fn run(environment: &mut dyn Environment, episode: u64, steps_max: usize) -> Episode {
    let spec = environment.spec();
    let (mut starts, mut actions) = streams(episode);
    let mut observation = vec![0xff; spec.observation.bytes()];
    let mut action = vec![0; spec.action.bytes()];
    environment.reset(&mut starts, &mut observation).expect("reset");
    let mut record =
        Episode { states: vec![(observation.clone(), environment.state_hash())], steps: vec![] };
    while record.steps.len() < steps_max {
        draw_action(&spec, &mut actions, &mut action);
        observation.fill(0xff);
        let step = environment.step(&action, &mut observation).expect("a valid action");
        record.states.push((observation.clone(), environment.state_hash()));
        record.steps.push(step);
        if step.ending.is_some() {
            break;
        }
    }
    record
}

#[test]
fn a_setting_that_was_completed_is_complete() {
    for task in tasks() {
        let complete = open(task).setting();
        assert!(complete.0.contains_key("coverage"), "{task}");
        let again = create(task, &complete).expect("an environment's own setting");
        assert_eq!(again.setting(), complete, "{task}");
    }
}

#[test]
fn a_task_takes_only_what_it_has() {
    for (task, setting, words) in [
        ("navigation", "noise = 1.0", &["noise", "coverage"][..]),
        ("navigation", "coverage = 0", &["`coverage`", "above 0 and at most 1"]),
        ("navigation", "coverage = \"half\"", &["coverage", "half"]),
        ("fetch-push", "noise = -1", &["`noise`", "0 to 3", "-1"]),
        ("fetch-pick", "coverage = 0.6", &["0.25, 0.5, 0.75 or 1", "0.6"]),
        ("fetch-pick", "contact_forces = true", &["contact_forces"]),
        ("fetch-push", "ranges = \"wide\"", &["wide", "symmetric"]),
        ("fetch-push", "action_scale = [0.1]", &["`action_scale`", "3 numbers"]),
        ("ant-reach", "noise = nan", &["`noise`", "NaN"]),
        ("ant-reach", "ranges = \"one-sided\"", &["ranges"]),
        ("chess", "", &["chess", "navigation, fetch-pick, fetch-push, ant-reach"]),
    ] {
        let setting = Setting(setting.parse().expect("a table"));
        let refusal = create(task, &setting).err().expect("no such setting").to_string();
        assert!(!refusal.contains('\n'), "{refusal}");
        for word in words {
            assert!(refusal.contains(word), "{task} {setting:?}: expected {word} in {refusal}");
        }
    }
}

#[test]
fn the_same_stream_gives_the_same_episode() {
    for task in tasks() {
        let (mut one, mut other) = (open(task), open(task));
        let episodes: Vec<_> = (0..20).map(|episode| run(&mut *one, episode, 1_000)).collect();
        for (episode, record) in episodes.iter().enumerate().rev() {
            assert_eq!(*record, run(&mut *other, episode as u64, 1_000), "{task} {episode}");
        }
        assert_ne!(episodes[0], episodes[1], "{task}: another stream gives another episode");
    }
}

#[test]
fn a_reset_amid_an_episode_leaves_no_trace() {
    for task in tasks() {
        let fresh = run(&mut *open(task), 7, 1_000);
        let mut used = open(task);
        for steps_max in [0, 1, 5] {
            run(&mut *used, 3, steps_max);
            let mut action = vec![0; used.spec().action.bytes()];
            used.expert_action(&mut action).unwrap();
            assert_eq!(fresh, run(&mut *used, 7, 1_000), "{task} after {steps_max} steps");
        }
    }
}

#[test]
fn observations_fit_the_spec() {
    for task in tasks() {
        let mut environment = open(task);
        let spec = environment.spec();
        for (observation, _) in
            (0..50).flat_map(|episode| run(&mut *environment, episode, 1_000).states)
        {
            match spec.observation {
                ObservationSpec::Cells { classes, .. } => {
                    assert!(
                        observation.iter().all(|class| usize::from(*class) < classes),
                        "{task}"
                    );
                }
                ObservationSpec::Vector { .. } => {
                    assert!(floats(&observation).all(f32::is_finite), "{task}");
                }
            }
        }
    }
}

#[test]
fn episodes_end_by_the_horizon_and_say_how() {
    for task in tasks() {
        let mut environment = open(task);
        let horizon_steps = environment.spec().horizon_steps as usize;
        for episode in 0..200 {
            let steps = run(&mut *environment, episode, usize::MAX).steps;
            let last = steps[steps.len() - 1];
            assert!(steps.len() <= horizon_steps, "{task}: {} steps", steps.len());
            if last.ending == Some(Ending::Truncated) {
                assert_eq!(steps.len(), horizon_steps, "{task}: only the horizon truncates");
            }
            assert!(steps.is_sorted_by_key(|step| step.success), "{task}: success stays");
            assert!(steps.iter().all(|step| step.reward.is_finite()), "{task}");
        }
    }
}

#[test]
fn steps_outside_an_episode_are_refused() {
    for task in tasks() {
        let mut environment = open(task);
        let mut observation = vec![0; environment.spec().observation.bytes()];
        let mut action = vec![0; environment.spec().action.bytes()];
        let refused = Err(EnvironmentError::NotRunning);
        assert_eq!(environment.step(&action, &mut observation), refused);
        assert!(
            !environment.expert_action(&mut action).unwrap(),
            "{task}: no expert before the first reset"
        );
        run(&mut *environment, 0, usize::MAX);
        assert_eq!(environment.step(&action, &mut observation), refused);
        assert!(
            !environment.expert_action(&mut action).unwrap(),
            "{task}: no expert after the end"
        );
    }
}

#[test]
fn a_refused_action_changes_nothing() {
    for task in tasks() {
        let mut environment = open(task);
        let (observation, hash) = run(&mut *environment, 0, 0).states.remove(0);
        let bad = match environment.spec().action {
            ActionSpec::Discrete { count } => vec![count as u8],
            ActionSpec::Continuous { len } => f32::NAN.to_le_bytes().repeat(len),
        };
        let mut after = observation.clone();
        assert!(environment.step(&bad, &mut after).is_err(), "{task}");
        assert!(environment.step(&[], &mut after).is_err(), "{task}");
        assert_eq!((after, environment.state_hash()), (observation, hash), "{task}");
    }
}

#[test]
fn a_step_of_navigation_allocates_nothing() {
    let mut environment = open("navigation");
    let (mut starts, mut actions) = streams(0);
    let mut observation = vec![0; environment.spec().observation.bytes()];
    let mut action = [0];
    environment.reset(&mut starts, &mut observation).expect("reset");
    let allocated = allocation_counter::measure(|| {
        loop {
            draw_action(&environment.spec(), &mut actions, &mut action);
            let step = environment.step(&action, &mut observation).expect("a valid action");
            if step.ending.is_some() {
                break;
            }
        }
    });
    assert_eq!(allocated.count_total, 0, "allocations in an episode");
}

/// Steps of the physics tasks are not measured, because rapier allocates in each of them.
#[test]
fn experts_hashes_poses_and_refusals_allocate_nothing() {
    for task in tasks() {
        let mut environment = open(task);
        let (mut starts, mut actions) = streams(0);
        let mut observation = vec![0; environment.spec().observation.bytes()];
        let mut action = vec![0; environment.spec().action.bytes()];
        let mut poses = Vec::with_capacity(environment.solids().len());
        environment.reset(&mut starts, &mut observation).expect("reset");
        loop {
            let allocated = allocation_counter::measure(|| {
                environment.expert_action(&mut action).unwrap();
                environment.state_hash();
                environment.append_poses(&mut poses);
                assert!(environment.step(&[], &mut observation).is_err());
            });
            assert_eq!(allocated.count_total, 0, "{task}");
            assert_eq!(poses.len(), environment.solids().len(), "{task}: a pose for each solid");
            poses.clear();
            draw_action(&environment.spec(), &mut actions, &mut action);
            let step = environment.step(&action, &mut observation).expect("a valid action");
            if step.ending.is_some() {
                break;
            }
        }
    }
}
