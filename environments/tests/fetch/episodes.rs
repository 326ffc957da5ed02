//! Observations and endings of episodes under experts, random actions and refused actions.

use super::{Fetch, TABLE_TOP, TASKS, noise};
use environments::fetch::{FetchSetting, FetchTask};
use environments::{Environment, EnvironmentError, Shape};
use protocol::ending::Ending;
use protocol::seed::{Purpose, stream};
use protocol::task::write_floats;
use rand::RngExt;

/// The hashes are the same in every process and with every optimization level; other processors are not guaranteed.
#[test]
#[cfg(target_arch = "x86_64")]
fn the_states_of_two_episodes_are_golden() {
    for (task, golden) in [
        (FetchTask::Pick, [0xed11_a138_a92d_7c89, 0x8e2a_3bde_17f0_386d]),
        (FetchTask::Push, [0xa711_69d2_982f_af46, 0xc535_5bd2_a561_ed4d]),
    ] {
        let mut fetch = Fetch::open(task, &FetchSetting::default());
        let mut actions = stream(1, Purpose::TrainingActions, 0, 0);
        let hashes = [false, true].map(|random| {
            fetch.reset(0);
            loop {
                let drawn = [(); 4].map(|()| actions.random_range(-1.0f32..1.0));
                let action = if random { drawn } else { fetch.expert() };
                if fetch.step(action).1.ending.is_some() {
                    return fetch.environment.state_hash();
                }
            }
        });
        assert_eq!(hashes, golden, "{task:?}: found {hashes:#x?}");
    }
}

#[test]
fn random_actions_never_leave_the_finite_numbers() {
    wander(20_000);
}

#[test]
#[ignore = "a million steps of each task, four minutes of one core"]
fn a_million_random_actions_never_leave_the_finite_numbers() {
    wander(1_000_000);
}

/// Takes `steps` random steps of each task.
fn wander(steps: u32) {
    for task in TASKS {
        let mut fetch = Fetch::open(task, &noise(2.0));
        let mut actions = stream(1, Purpose::TrainingActions, 0, 0);
        let (mut episode, mut begun) = (0, false);
        for _ in 0..steps {
            if !begun {
                fetch.reset(episode);
                episode += 1;
            }
            let action = [(); 4].map(|()| actions.random_range(-1.0f32..1.0));
            let (observation, step) = fetch.step(action);
            begun = step.ending.is_none();
            let is_near = observation.iter().all(|number| number.abs() < 10.0);
            assert!(is_near, "{task:?}, episode {episode}: {observation:?}");
            // What falls from the table sinks into the floor for a moment.
            assert!(observation[5] > -0.01, "{task:?}, episode {episode}: under the floor");
        }
    }
}

#[test]
fn an_observation_says_where_everything_is() {
    for task in TASKS {
        let mut fetch = Fetch::open(task, &FetchSetting::default());
        let start = fetch.reset(0);
        for step in 0..20 {
            let action = fetch.expert();
            let (found, _) = fetch.step(action);
            for axis in 0..3 {
                assert_eq!(found[6 + axis], found[3 + axis] - found[axis], "{task:?} {step}");
                assert_eq!(found[3 + axis], fetch.pose("cube").position[axis], "{task:?} {step}");
                assert_eq!(found[13 + axis], start[13 + axis], "{task:?}: the goal stays");
                assert_eq!(found[13 + axis], fetch.pose("goal").position[axis], "{task:?}");
            }
            let fingers = ["right finger", "left finger"].map(|name| fetch.pose(name).position);
            assert!((fingers[0][1] - found[1] - 0.0079 - found[9]).abs() < 1e-5, "{task:?} {step}");
            assert!(
                (found[1] - fingers[1][1] - 0.0079 - found[10]).abs() < 1e-5,
                "{task:?} {step}"
            );
        }
    }
}

#[test]
fn an_action_that_is_no_number_is_refused() {
    let mut fetch = Fetch::open(FetchTask::Push, &FetchSetting::default());
    fetch.reset(0);
    let hash = fetch.environment.state_hash();
    let mut action = [0; 12];
    write_floats([0.0, f32::NAN, 0.0], &mut action);
    match fetch.environment.step(&action, &mut fetch.bytes) {
        Err(EnvironmentError::ActionNotFinite { index: 1, .. }) => {}
        other => panic!("expected a refusal of the second number, found {other:?}"),
    }
    assert_eq!(fetch.environment.state_hash(), hash);
}

#[test]
fn success_ends_the_episode_and_rewards_are_gym_s() {
    for task in TASKS {
        let mut fetch = Fetch::open(task, &FetchSetting::default());
        fetch.reset(1);
        loop {
            let action = fetch.expert();
            let (found, step) = fetch.step(action);
            let distance = (0..3).map(|axis| (found[3 + axis] - found[13 + axis]).powi(2));
            let near = distance.sum::<f32>().sqrt() < 0.05;
            assert_eq!(step.success, near, "{task:?}");
            assert_eq!(step.reward, if near { 0.0 } else { -1.0 }, "{task:?}");
            assert_eq!(step.ending, near.then_some(Ending::GoalReached), "{task:?}");
            if near {
                break;
            }
        }
        fetch.reset(1);
        for taken in 1..=task.spec().horizon_steps {
            let (_, step) = fetch.step([0.0; 4]);
            assert_eq!((step.success, step.reward), (false, -1.0), "{task:?}");
            let ending = (taken == task.spec().horizon_steps).then_some(Ending::Truncated);
            assert_eq!(step.ending, ending, "{task:?}");
        }
    }
}

#[test]
fn the_solids_have_names_of_their_own_and_the_goal_its_size() {
    for task in TASKS {
        let mut fetch = Fetch::open(task, &FetchSetting::default());
        fetch.reset(0);
        let solids = fetch.environment.solids();
        let mut names: Vec<_> = solids.iter().map(|solid| solid.name).collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), solids.len());
        let goal = solids.iter().find(|solid| solid.name == "goal").expect("a goal");
        assert_eq!(goal.shape, Shape::Ball { radius: 0.05 });
        let table = fetch.pose("table").position[2];
        assert!((table + 0.2 - TABLE_TOP).abs() < 1e-6);
        let palm = fetch.pose("palm").position[2];
        assert!(palm > fetch.pose("right finger").position[2], "the palm is over its fingers");
    }
}
