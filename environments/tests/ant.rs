//! Ant Reach as seen by an agent (paper, Section 4.5): starts and goals, effects of actions, contents of observations,
//! and the stability of long runs of random torques.

use environments::ant::{Ant, AntSetting};
use environments::{Environment, Step};
use protocol::ending::Ending;
use protocol::seed::{Purpose, Stream, stream};
use protocol::task::{floats, write_floats};
use rand::RngExt;
use std::f32::consts::FRAC_1_SQRT_2;
use xxhash_rust::xxh3::xxh3_64;

/// The coordinates of a start without noise, except the goal's x and y.
const START: [f32; 20] = [
    0.55,
    1.0,
    0.0,
    0.0,
    0.0,
    0.0,
    1.0,
    0.0,
    -1.0,
    0.0,
    -1.0,
    0.0,
    1.0,
    f32::NAN,
    f32::NAN,
    0.51,
    FRAC_1_SQRT_2,
    FRAC_1_SQRT_2,
    0.0,
    0.0,
];
const RATES: usize = 26;
const FORCES: std::ops::Range<usize> = 40..130;
const TO_GOAL: usize = 130;

/// An environment and its latest observation.
struct Run {
    environment: Ant,
    bytes: Vec<u8>,
}

impl Run {
    fn new(setting: &AntSetting) -> Run {
        let environment = Ant::new(setting.clone()).expect("a setting of the task");
        let bytes = vec![0; environment.spec().observation.bytes()];
        Run { environment, bytes }
    }

    fn reset(&mut self, episode: u64) -> [f32; 132] {
        let mut starts = stream(1, Purpose::TrainingEpisode, 0, episode);
        self.environment.reset(&mut starts, &mut self.bytes).expect("reset");
        self.observation()
    }

    fn step(&mut self, numbers: [f32; 8]) -> Step {
        let mut action = [0; 32];
        write_floats(numbers, &mut action);
        self.environment.step(&action, &mut self.bytes).expect("a step")
    }

    fn observation(&self) -> [f32; 132] {
        let mut numbers = floats(&self.bytes);
        std::array::from_fn(|_| numbers.next().expect("132 numbers"))
    }
}

fn noisy(noise: f64) -> AntSetting {
    AntSetting { noise, ..AntSetting::default() }
}

fn draw(actions: &mut Stream) -> [f32; 8] {
    std::array::from_fn(|_| actions.random_range(-1.0..1.0))
}

fn length(vector: &[f32]) -> f32 {
    vector.iter().map(|number| number * number).sum::<f32>().sqrt()
}

/// Returns the sector of nine degrees in which the goal of an observation lies.
fn bin(observation: &[f32; 132]) -> usize {
    let [x, y] = [observation[13], observation[14]];
    (f64::from(y).atan2(f64::from(x)) / (std::f64::consts::PI / 20.0)) as usize
}

#[test]
fn goals_lie_on_the_half_circle_all_around() {
    let mut run = Run::new(&AntSetting::default());
    let mut bins = [0; 20];
    for episode in 0..1_000 {
        let observation = run.reset(episode);
        let goal = &observation[13..15];
        assert!((length(goal) - 5.0).abs() < 1e-5, "{goal:?}");
        assert!(goal[1] >= 0.0, "{goal:?}");
        assert_eq!(goal, &observation[TO_GOAL..], "the torso is at the origin");
        bins[bin(&observation)] += 1;
    }
    assert!(bins.iter().all(|count| (25..=80).contains(count)), "{bins:?}");
}

#[test]
fn a_coverage_leaves_goals_out() {
    for (coverage, kept) in [(0.25, 5), (0.5, 10), (0.75, 15)] {
        let mut run = Run::new(&AntSetting { coverage, ..AntSetting::default() });
        let mut bins = [false; 20];
        for episode in 0..300 {
            bins[bin(&run.reset(episode))] = true;
        }
        assert_eq!(bins.iter().filter(|seen| **seen).count(), kept, "{coverage}: {bins:?}");
        assert_eq!(bins[2], coverage == 0.25 || coverage == 0.5, "{coverage}");
    }
}

#[test]
fn an_episode_without_noise_starts_at_the_start() {
    let mut run = Run::new(&AntSetting::default());
    for episode in 0..50 {
        let observation = run.reset(episode);
        for (index, (found, start)) in observation.iter().zip(START).enumerate() {
            assert!(start.is_nan() || (found - start).abs() < 1e-6, "{index}: {found}");
        }
        let velocities = &observation[20..34];
        assert!(velocities.iter().all(|it| it.abs() <= 0.005 && *it != 0.0), "{velocities:?}");
        assert!(observation[34..40].iter().all(|it| *it == 0.0), "the mark stands still");
    }
}

/// Returns the smallest and the largest deviation of every coordinate from a start without noise: first the ant's x
/// and y, then the coordinates in [`START`].
fn spreads(setting: &AntSetting) -> ([f32; 22], [f32; 22]) {
    let mut run = Run::new(setting);
    let (mut low, mut high) = ([f32::MAX; 22], [f32::MIN; 22]);
    for episode in 0..400 {
        let observation = run.reset(episode);
        assert!((length(&observation[13..15]) - 5.0).abs() < 1e-5, "the goal itself has none");
        assert!((length(&observation[1..5]) - 1.0).abs() < 1e-6, "a unit quaternion");
        let position = [0, 1].map(|axis| observation[13 + axis] - observation[TO_GOAL + axis]);
        let coordinates = observation.iter().zip(START).map(|(found, start)| found - start);
        for (index, spread) in position.into_iter().chain(coordinates).enumerate() {
            low[index] = low[index].min(spread);
            high[index] = high[index].max(spread);
        }
    }
    (low, high)
}

#[test]
fn noise_spreads_every_coordinate_of_the_ant_as_wide_as_it_says() {
    let (low, high) = spreads(&noisy(0.05));
    // The position and the angles of the joints.
    for index in [0, 1, 2].into_iter().chain(7..15) {
        assert!((-0.05001..-0.047).contains(&low[index]), "{index} from {}", low[index]);
        assert!((0.047..0.05001).contains(&high[index]), "{index} to {}", high[index]);
    }
    // The vector part of the quaternion: normalization changes it slightly.
    for index in 4..7 {
        assert!((-0.055..-0.045).contains(&low[index]), "{index} from {}", low[index]);
        assert!((0.045..0.055).contains(&high[index]), "{index} to {}", high[index]);
    }
}

#[test]
fn the_mark_of_the_goal_has_noise_where_it_is_asked_for() {
    let (low, high) = spreads(&noisy(0.05));
    assert!((17..22).all(|index| low[index].abs() < 1e-6 && high[index].abs() < 1e-6));
    let (low, high) = spreads(&AntSetting { mark_noise: true, ..noisy(0.05) });
    for index in 17..22 {
        assert!((-0.06..-0.03).contains(&low[index]), "{index} from {}", low[index]);
        assert!((0.03..0.06).contains(&high[index]), "{index} to {}", high[index]);
    }
}

#[test]
fn each_number_of_an_action_turns_its_joint() {
    let actuated = [6, 7, 0, 1, 2, 3, 4, 5];
    let mut run = Run::new(&AntSetting::default());
    for (index, joint) in actuated.into_iter().enumerate() {
        for sign in [1.0, -1.0] {
            run.reset(0);
            let mut action = [0.0; 8];
            action[index] = 0.2 * sign;
            run.step(action);
            let rates = &run.observation()[RATES..RATES + 8];
            let rate = rates[joint] * sign;
            // Friction on the floor slows the feet slightly.
            let slowest = if joint % 2 == 0 { 2.6 } else { 2.2 };
            assert!((slowest..3.0).contains(&rate), "{index}: 30 N m for 0.1 s: {rates:?}");
            let others = rates.iter().enumerate().filter(|(other, _)| *other != joint);
            assert!(others.clone().all(|(_, other)| other.abs() < 0.5), "{index}: {rates:?}");
        }
    }
}

#[test]
fn actions_are_scaled_then_clipped() {
    let scaled = AntSetting { action_scale: vec![0.5; 8], ..AntSetting::default() };
    let bytes_after = |setting: &AntSetting, number: f32| {
        let mut run = Run::new(setting);
        run.reset(3);
        run.step([number; 8]);
        run.bytes
    };
    let plain = AntSetting::default();
    assert_eq!(bytes_after(&plain, 1.0), bytes_after(&plain, 7.0));
    assert_eq!(bytes_after(&plain, 0.5), bytes_after(&scaled, 1.0));
    assert_eq!(bytes_after(&plain, 1.0), bytes_after(&scaled, 2.5));
    assert_ne!(bytes_after(&plain, 1.0), bytes_after(&plain, 0.9));
}

#[test]
fn the_reward_is_that_of_the_authors_expert() {
    let mut run = Run::new(&noisy(0.03));
    let mut actions = stream(1, Purpose::TrainingActions, 0, 0);
    run.reset(0);
    for _ in 0..20 {
        // Outside the clipping range: the reward uses the action before clipping.
        let action = draw(&mut actions).map(|number| 2.0 * number);
        let step = run.step(action);
        let distance = length(&run.observation()[TO_GOAL..]);
        let expected = 1.0 - distance / 5.0 - 0.005 * length(&action).powi(2);
        assert!((step.reward - expected).abs() < 1e-5, "{step:?}, expected {expected}");
        assert!(!step.success, "nobody gets there so soon");
    }
}

#[test]
fn contact_forces_are_seen_only_when_asked_for() {
    let mut blind = Run::new(&AntSetting::default());
    let mut feeling = Run::new(&AntSetting { contact_forces: true, ..AntSetting::default() });
    let mut actions = stream(1, Purpose::TrainingActions, 0, 0);
    let mut felt = 0;
    for run in [&mut blind, &mut feeling] {
        run.reset(0);
    }
    for _ in 0..50 {
        let action = draw(&mut actions);
        blind.step(action);
        feeling.step(action);
        let (zeros, forces) = (blind.observation(), feeling.observation());
        assert!(zeros[FORCES].iter().all(|number| *number == 0.0));
        let forces = &forces[FORCES];
        assert!(forces.iter().all(|number| (-1.0..=1.0).contains(number)), "{forces:?}");
        assert!(forces[..6].iter().chain(&forces[84..]).all(|number| *number == 0.0));
        felt += forces.iter().filter(|number| **number != 0.0).count();
    }
    assert!(felt > 60, "{felt} numbers in 50 steps of leaps");
    assert_eq!(blind.environment.state_hash(), feeling.environment.state_hash());
}

/// Runs episodes of random torques, checks every state, and returns the distance traveled in each.
fn wander(setting: &AntSetting, episodes: u64) -> Vec<f32> {
    let mut run = Run::new(setting);
    let mut travels = Vec::new();
    for episode in 0..episodes {
        let mut actions = stream(1, Purpose::TrainingActions, 0, episode);
        let start = run.reset(episode);
        for step in 1..=50 {
            let taken = run.step(draw(&mut actions));
            assert_eq!(taken.ending, (step == 50).then_some(Ending::Truncated));
            let observation = run.observation();
            assert!(observation.iter().all(|number| number.is_finite()), "{observation:?}");
            let height = observation[0];
            // In MuJoCo one leap in a hundred exceeds 2.5 m; the highest of 400 reaches 3.2 m.
            assert!((0.1..6.0).contains(&height), "episode {episode}: {height} m");
            let norm = length(&observation[1..5]);
            assert!((norm - 1.0).abs() < 1e-3, "episode {episode}: a quaternion of {norm}");
            let speed = length(&observation[20..23]);
            assert!(speed < 15.0, "episode {episode}: {speed} m/s");
        }
        let last = run.observation();
        let travel = [0, 1].map(|axis| start[TO_GOAL + axis] - last[TO_GOAL + axis]);
        travels.push(length(&travel));
    }
    travels
}

#[test]
fn random_torques_travel_as_far_as_in_mujoco() {
    let travels = wander(&AntSetting::default(), 50);
    let mean = travels.iter().sum::<f32>() / 50.0;
    // 2.25 m in MuJoCo, 2.02 m in the prototype, with a standard error of 0.18 m.
    assert!((1.4..2.8).contains(&mean), "{mean} m");
}

#[test]
fn noisy_starts_stay_sane() {
    wander(&noisy(0.05), 50);
}

#[test]
#[ignore = "a million steps, seven minutes of one core"]
fn a_million_random_steps_stay_sane() {
    wander(&noisy(0.05), 20_000);
}

/// The bytes of an episode are the same on every machine and in every build.
#[test]
fn an_episode_has_its_recorded_bytes() {
    let setting = AntSetting { contact_forces: true, mark_noise: true, ..noisy(0.05) };
    let mut run = Run::new(&setting);
    let mut actions = stream(1, Purpose::TrainingActions, 0, 0);
    run.reset(0);
    let mut bytes = run.bytes.clone();
    for _ in 0..50 {
        run.step(draw(&mut actions));
        bytes.extend_from_slice(&run.bytes);
    }
    assert_eq!(format!("{:016x}", xxh3_64(&bytes)), "96f3488569a62948");
}
