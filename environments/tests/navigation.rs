//! Navigation and its expert compared with the paper and the authors' code: success rates, path lengths, coverage and
//! rewards, computed only from observations and steps.

use environments::navigation::{AGENT, EMPTY, GOAL, Navigation, NavigationSetting, WALL};
use environments::{Environment, Step};
use proptest::prelude::*;
use protocol::ending::Ending;
use protocol::seed::{Purpose, stream};
use rand::RngExt;
use std::collections::BTreeSet;

const SIZE: usize = 19;
const CELLS: usize = SIZE * SIZE;

fn open(coverage: f64) -> Navigation {
    Navigation::new(NavigationSetting { coverage, ..NavigationSetting::default() })
        .expect("a coverage of the paper")
}

fn reset(environment: &mut dyn Environment, episode: u64) -> [u8; CELLS] {
    let mut observation = [0; CELLS];
    let mut starts = stream(1, Purpose::Demonstration, 0, episode);
    environment.reset(&mut starts, &mut observation).expect("reset");
    observation
}

/// Acts until the episode ends; returns the last observation, the number of steps and the last step.
fn finish(
    environment: &mut dyn Environment,
    mut choose: impl FnMut(&mut dyn Environment) -> u8,
) -> ([u8; CELLS], u32, Step) {
    let mut observation = [0; CELLS];
    for taken in 1.. {
        let action = choose(environment);
        let step = environment.step(&[action], &mut observation).expect("a valid action");
        if step.ending.is_some() {
            return (observation, taken, step);
        }
    }
    unreachable!("the horizon ends every episode")
}

fn expert(environment: &mut dyn Environment) -> u8 {
    let mut action = [0];
    assert!(environment.expert_action(&mut action).expect("a script does not fail"));
    action[0]
}

fn place(observation: &[u8; CELLS], class: u8) -> Option<usize> {
    observation.iter().position(|found| *found == class)
}

/// Returns the length of the shortest path from agent to goal, found by flooding the free cells ring by ring.
fn shortest(observation: &[u8; CELLS]) -> u32 {
    let goal = place(observation, GOAL).expect("a goal");
    let mut reached = BTreeSet::from([place(observation, AGENT).expect("an agent")]);
    let mut steps = 0;
    while !reached.contains(&goal) {
        let ring = reached.iter().flat_map(|cell| [cell + 1, cell - 1, cell + SIZE, cell - SIZE]);
        let grown: BTreeSet<_> =
            ring.filter(|cell| observation[*cell] != WALL).chain(reached.iter().copied()).collect();
        assert_ne!(grown, reached, "the goal can be reached");
        reached = grown;
        steps += 1;
    }
    steps
}

/// Renders the observation as text: `#` wall, `.` free, `G` goal, `A` agent.
fn picture(observation: &[u8; CELLS]) -> String {
    let rows = observation.chunks(SIZE);
    rows.map(|row| {
        row.iter()
            .map(|class| b".#GA"[usize::from(*class)] as char)
            .chain(['\n'])
            .collect::<String>()
    })
    .collect()
}

#[test]
fn the_first_observation_of_a_seed_is_the_golden_picture() {
    let first = picture(&reset(&mut open(1.0), 0));
    assert_eq!(first, include_str!("golden/navigation_first_observation.txt"), "found:\n{first}");
}

#[test]
fn the_expert_always_succeeds_in_the_mean_path_length_of_the_paper() {
    let mut environment = open(1.0);
    let mut steps_total = 0;
    for episode in 0..1_000 {
        reset(&mut environment, episode);
        let (last, steps, step) = finish(&mut environment, expert);
        assert!(step.success && step.ending == Some(Ending::GoalReached), "episode {episode}");
        assert_eq!(step.reward, 1.0 - 0.9 * steps as f32 / 100.0);
        assert_eq!(place(&last, GOAL), None, "the agent hides the goal");
        steps_total += steps;
    }
    let mean = f64::from(steps_total) / 1_000.0;
    assert!((mean - 13.54).abs() < 0.3, "mean path length {mean}");
}

#[test]
fn a_random_policy_succeeds_as_often_as_in_the_authors_code() {
    let mut environment = open(1.0);
    let episodes = 5_000;
    let mut successes = 0;
    for episode in 0..episodes {
        reset(&mut environment, episode);
        let mut actions = stream(1, Purpose::TrainingActions, 0, episode);
        let (_, steps, step) = finish(&mut environment, |_| actions.random_range(0..4u8));
        if step.success {
            successes += 1;
        } else {
            let truncated = Step { reward: 0.0, ending: Some(Ending::Truncated), success: false };
            assert_eq!((steps, step), (100, truncated));
        }
    }
    let percent = 100.0 * f64::from(successes) / episodes as f64;
    assert!((percent - 12.8).abs() < 2.0, "a random policy succeeds in {percent} %");
}

#[test]
fn an_episode_that_does_not_end_at_the_goal_goes_on_to_the_horizon() {
    let setting = NavigationSetting { end_at_goal: false, ..NavigationSetting::default() };
    let mut environment = Navigation::new(setting).expect("a valid setting");
    let mut ends = open(1.0);
    for episode in 0..20 {
        assert_eq!(reset(&mut environment, episode), reset(&mut ends, episode));
        let (at_goal, path, arrival) = finish(&mut ends, expert);
        let mut observation = [0; CELLS];
        for _ in 1..path {
            let action = expert(&mut environment);
            environment.step(&[action], &mut observation).expect("a valid action");
        }
        let action = expert(&mut environment);
        let step = environment.step(&[action], &mut observation).expect("a valid action");
        assert_eq!((step, observation), (Step { ending: None, ..arrival }, at_goal));
        let asked = environment.expert_action(&mut [0]).expect("a script does not fail");
        assert!(!asked, "the expert has arrived");
        // Success holds for the rest of the episode and is rewarded once.
        let (_, further, last) = finish(&mut environment, |_| 0);
        let truncated = Step { reward: 0.0, ending: Some(Ending::Truncated), success: true };
        assert_eq!((path + further, last), (100, truncated));
    }
}

#[test]
fn a_move_against_a_wall_costs_a_step_and_nothing_else() {
    let mut environment = open(1.0);
    let mut observation = reset(&mut environment, 0);
    // No row has seventeen moves to the left, so the agent ends at a wall.
    for _ in 0..17 {
        environment.step(&[2], &mut observation).expect("a valid action");
    }
    let (before, hash) = (observation, environment.state_hash());
    let step = environment.step(&[2], &mut observation).expect("a valid action");
    assert_eq!(step, Step { reward: 0.0, ending: None, success: false });
    assert_eq!(observation, before);
    assert_ne!(environment.state_hash(), hash, "the step counts");
}

#[test]
fn starts_and_goals_come_from_the_coverage_and_never_from_doors() {
    let mut wider = None;
    for (coverage, count) in [(1.0, 256), (0.75, 192), (0.5, 128), (0.25, 64)] {
        let mut environment = open(coverage);
        let (mut starts, mut goals) = (BTreeSet::new(), BTreeSet::new());
        for episode in 0..10_000 {
            let observation = reset(&mut environment, episode);
            starts.insert(place(&observation, AGENT).expect("an agent"));
            goals.insert(place(&observation, GOAL).expect("a goal"));
        }
        assert_eq!(starts, goals, "coverage {coverage}: the same cells for both");
        assert_eq!(starts.len(), count, "coverage {coverage}: every cell of it is drawn");
        let inner_walls = |cell: &usize| cell % SIZE == 9 || cell / SIZE == 9;
        assert!(!starts.iter().any(inner_walls), "coverage {coverage}: no doors");
        assert!(wider.is_none_or(|wider: BTreeSet<_>| starts.is_subset(&wider)));
        wider = Some(starts);
    }
}

#[test]
fn every_wall_segment_has_one_door_and_each_of_its_cells_can_be_it() {
    let mut environment = open(1.0);
    let mut doors = BTreeSet::new();
    for episode in 0..500 {
        let observation = reset(&mut environment, episode);
        let count = |class| observation.iter().filter(|found| **found == class).count();
        assert_eq!([EMPTY, WALL, GOAL, AGENT].map(count), [258, 101, 1, 1]);
        for room in [1..9, 10..18] {
            let rows: Vec<_> =
                room.clone().filter(|y| observation[SIZE * y + 9] == EMPTY).collect();
            let columns: Vec<_> = room.filter(|x| observation[SIZE * 9 + x] == EMPTY).collect();
            assert_eq!((rows.len(), columns.len()), (1, 1), "episode {episode}");
            doors.insert((9, rows[0]));
            doors.insert((columns[0], 9));
        }
    }
    assert_eq!(doors.len(), 32, "every place of a door is drawn");
}

proptest! {
    #[test]
    fn the_expert_s_path_is_shortest(episode: u64, coverage in 0.01..=1.0) {
        let mut environment = open(coverage);
        let first = reset(&mut environment, episode);
        let (_, steps, _) = finish(&mut environment, expert);
        prop_assert_eq!(steps, shortest(&first));
    }

    #[test]
    fn the_expert_finds_back_from_wherever_it_is_led(episode: u64, detour in prop::collection::vec(0..4u8, 1..40)) {
        let mut environment = open(1.0);
        let mut observation = reset(&mut environment, episode);
        for action in detour {
            expert(&mut environment);
            let step = environment.step(&[action], &mut observation).expect("a valid action");
            if step.ending.is_some() {
                return Ok(());
            }
        }
        let (_, steps, step) = finish(&mut environment, expert);
        prop_assert!(step.success);
        prop_assert_eq!(steps, shortest(&observation));
    }
}
