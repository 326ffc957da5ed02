//! The learners that imitate: each finds the expert's actions in a small world, the number of threads changes
//! no bit of it, and a restored learner continues identically.

#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use learner::algorithm::{self, PolicyLearner, Schedule};
use learner::state::PolicyState;
use networks::{ActorCritic, Batch, PolicyArchitecture, PolicyWorkspace};
use protocol::ending::Ending;
use protocol::seed::{Purpose, Stream, stream};
use protocol::task::{floats, write_floats};
use protocol::tensors::Tensors;
use protocol::trajectory::{Encoded, Source, Trajectory};
use rand::RngExt;
use run::config::RunConfig;

fn config(task: &str, settings: &[&str]) -> RunConfig {
    let settings: Vec<String> = settings.iter().map(|&setting| setting.to_owned()).collect();
    run::tasks::configuration(task, None, &settings).unwrap()
}

/// A corridor in a grid: places 1 to 17 of row 1, with goals at both ends. Action 0 goes right, action 2 left.
struct Corridor;

/// A place and the goal.
type Place = (usize, usize);

impl Corridor {
    fn observation((place, goal): Place) -> Vec<u8> {
        let mut cells = vec![1; 361];
        cells[20..37].fill(0);
        cells[19 + goal] = 2;
        cells[19 + place] = 3;
        cells
    }

    fn expert((place, goal): Place) -> u8 {
        if goal > place { 0 } else { 2 }
    }

    fn step((place, goal): Place, action: u8) -> Place {
        match action {
            0 => ((place + 1).min(17), goal),
            2 => ((place - 1).max(1), goal),
            _ => (place, goal),
        }
    }

    /// Runs an episode from a place, to the goal or for 30 steps.
    fn episode(from: Place, source: Source, mut act: impl FnMut(Place) -> u8) -> Trajectory {
        let (mut place, mut cells, mut actions) = (from, Self::observation(from), Vec::new());
        while actions.len() < 30 && place.0 != place.1 {
            let action = act(place);
            place = Self::step(place, action);
            actions.push(action);
            cells.extend(Self::observation(place));
        }
        let success = place.0 == place.1;
        let steps = actions.len() as u32;
        let log_probs = if source == Source::Demonstration { 0 } else { 4 * actions.len() };
        Trajectory {
            task: "navigation".to_owned(),
            source: source as i32,
            steps,
            observation_shape: vec![19, 19],
            cells: cells.into(),
            discrete_actions: actions.into(),
            log_probs: vec![0; log_probs].into(),
            ending: if success { Ending::GoalReached } else { Ending::Truncated } as i32,
            success,
            steps_to_goal: if success { steps } else { 0 },
            ..Trajectory::default()
        }
    }

    fn demonstrations() -> Vec<Trajectory> {
        let starts = (2..16).flat_map(|place| [(place, 1), (place, 17)]);
        starts.map(|from| Self::episode(from, Source::Demonstration, Self::expert)).collect()
    }

    /// Returns the episodes of an agent that acts at random.
    fn wandering(draws: &mut Stream, episodes: usize) -> Vec<Encoded> {
        let episode = |_| {
            let goal = if draws.random::<bool>() { 1 } else { 17 };
            let from = (draws.random_range(2..17), goal);
            Self::episode(from, Source::Training, |_| draws.random_range(0..4))
        };
        (0..episodes).map(episode).map(Encoded::encode).collect()
    }

    /// Returns the share of places where the policy's most probable action is the expert's.
    fn agreement(config: &RunConfig, policy: &PolicyState) -> f64 {
        let places: Vec<Place> = (2..17).flat_map(|place| [(place, 1), (place, 17)]).collect();
        let observations: Vec<u8> =
            places.iter().flat_map(|&place| Self::observation(place)).collect();
        let found = modes(config, policy, &observations);
        let same =
            found.iter().zip(&places).filter(|(found, place)| found[0] == Self::expert(**place));
        same.count() as f64 / places.len() as f64
    }
}

/// Returns the most probable action for each observation.
fn modes(config: &RunConfig, policy: &PolicyState, observations: &[u8]) -> Vec<Vec<u8>> {
    let spec = config.task.spec();
    let architecture = PolicyArchitecture::from(&config.policy);
    let network = ActorCritic::new(spec.observation, spec.action, &architecture);
    let prepared = network.prepare(&policy.parameters);
    let mut observations = observations.to_vec();
    policy.normalizer.normalize(&mut observations);
    let mut workspace = PolicyWorkspace::default();
    let outputs = network.act(&prepared, Batch::new(&observations), &mut workspace);
    let mode = |row: &[f32]| {
        let mut action = vec![0; spec.action.bytes()];
        network.distribution().mode(row, &mut action);
        action
    };
    outputs.as_slice().chunks_exact(outputs.nrows()).map(mode).collect()
}

fn schedule(config: &RunConfig, iteration: u64) -> Schedule {
    let learning_rate = config.policy_learning_rate().at(iteration);
    Schedule { run_seed: 1, iteration, learning_rate }
}

/// What there is to learn from: demonstrations, and twenty episodes of an agent that acts at random.
struct World {
    demonstrations: Vec<Trajectory>,
    wandering: fn(&mut Stream) -> Vec<Encoded>,
}

impl World {
    fn corridor() -> World {
        let wandering = |draws: &mut Stream| Corridor::wandering(draws, 20);
        World { demonstrations: Corridor::demonstrations(), wandering }
    }

    fn line() -> World {
        let shown = |number| line(number as f32 / 20.0 - 1.0, Source::Demonstration, expert);
        World { demonstrations: (0..40).map(shown).collect(), wandering: line_at_random }
    }

    fn batch(&self, iteration: u64) -> Vec<Encoded> {
        (self.wandering)(&mut stream(1, Purpose::TrainingActions, iteration, 0))
    }

    /// Trains for `iterations` iterations.
    fn train(
        &self,
        config: &RunConfig,
        iterations: u64,
        threads: usize,
    ) -> (Box<dyn PolicyLearner>, PolicyState) {
        let (mut learner, mut policy) = algorithm::create(config, &self.demonstrations);
        let threads = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        for iteration in 0..iterations {
            let batch = self.batch(iteration);
            let schedule = schedule(config, iteration);
            let update = || learner.update(&mut policy, &batch, &[], &schedule);
            let metrics = threads.install(update).unwrap();
            assert!(metrics.policy_loss.is_finite() && metrics.value_loss.is_finite());
        }
        (learner, policy)
    }
}

const SMALL: [&str; 3] =
    ["policy.convolution_channels=[4, 4, 4]", "policy.features=16", "cloning.learning_rate=0.001"];

fn small(method: &str, settings: &[&str]) -> RunConfig {
    let method = format!("method={method}");
    let cloning = if method.ends_with("sqil") { 2 } else { 3 };
    config("navigation", &[&[&method[..]], &SMALL[..cloning], settings].concat())
}

fn bco() -> RunConfig {
    small(
        "bco",
        &[
            "inverse_dynamics.convolution_channels=[8, 8, 8]",
            "inverse_dynamics.features=32",
            "inverse_dynamics.learning_rate=0.003",
            "inverse_dynamics.samples=1024",
            "inverse_dynamics.batch=16",
            "inverse_dynamics.exploration_steps=1000",
            "cloning.batch=16",
            "cloning.epochs=12",
        ],
    )
}

fn sqil() -> RunConfig {
    small(
        "sqil",
        &[
            "steps=20000",
            "sqil.learning_rate=0.003",
            "sqil.exploration_steps=500",
            "sqil.updates_per_step=0.1",
            "sqil.target_rate=0.01",
            "sqil.gamma=0.9",
        ],
    )
}

fn soft_actor_critic() -> RunConfig {
    config(
        "fetch-push",
        &[
            "method=sqil",
            "policy.hidden=[32]",
            "sqil.hidden=[32]",
            "sqil.learning_rate=0.003",
            "sqil.exploration_steps=100",
            "sqil.gamma=0.9",
            "sqil.target_rate=0.02",
            "sqil.batch=64",
        ],
    )
}

#[test]
fn cloning_ends_with_the_expert_and_holds_on_what_was_held_out() {
    let config = small("bc", &["cloning.patience=150", "cloning.batch=16"]);
    let (mut learner, mut policy) = algorithm::create(&config, &Corridor::demonstrations());
    assert!(Corridor::agreement(&config, &policy) < 0.8);
    let mut losses = Vec::new();
    for iteration in 0..config.iterations() {
        if learner.is_finished() {
            break;
        }
        let metrics = learner.update(&mut policy, &[], &[], &schedule(&config, iteration)).unwrap();
        losses.push(metrics.held_out_loss);
    }
    assert!(learner.is_finished() && losses.len() < 1000, "{} passes", losses.len());
    let best = losses.iter().copied().fold(f64::INFINITY, f64::min);
    assert_eq!(losses[losses.len() - 151], best, "patience counts from the best pass");
    assert!(best < 0.2, "held out {best} nats");
    assert!(Corridor::agreement(&config, &policy) > 0.95);
}

#[test]
fn cloning_ends_at_an_action_too_large_for_a_loss_wherever_it_is_split_to() {
    let config = config("fetch-push", &["method=bc", "policy.hidden=[8]"]);
    for number in 0..40 {
        let mut demonstrations = World::line().demonstrations;
        let actions = [1e30f32; 30].map(f32::to_le_bytes).concat();
        demonstrations[number].continuous_actions = actions.into();
        let (mut learner, mut policy) = algorithm::create(&config, &demonstrations);
        let error = learner.update(&mut policy, &[], &[], &schedule(&config, 0)).unwrap_err();
        let words = "the learner diverged: expected finite metrics, found";
        assert!(error.to_string().starts_with(words), "demonstration {number}: {error}");
    }
}

#[test]
fn actions_are_inferred_from_what_the_agent_did_itself() {
    let config = bco();
    let (_, early) = World::corridor().train(&config, 1, 2);
    assert_eq!(
        early.parameters,
        algorithm::create(&config, &Corridor::demonstrations()).1.parameters
    );
    let (_, policy) = World::corridor().train(&config, 60, 2);
    let agreement = Corridor::agreement(&config, &policy);
    assert!(agreement > 0.9, "{agreement}");
}

#[test]
fn soft_q_learning_follows_the_expert() {
    let config = sqil();
    let (_, policy) = World::corridor().train(&config, 60, 2);
    let agreement = Corridor::agreement(&config, &policy);
    assert!(agreement > 0.9, "{agreement}");
}

#[test]
fn a_soft_actor_critic_follows_the_expert() {
    let config = soft_actor_critic();
    let (_, policy) = World::line().train(&config, 25, 2);
    for place in [-0.8f32, -0.4, 0.4, 0.8] {
        let action = modes(&config, &policy, &point(place)).remove(0);
        let found = floats(&action).next().unwrap();
        let wanted = expert(place);
        assert!((found - wanted).abs() < 0.3, "at {place}: expected {wanted}, found {found}");
    }
}

#[test]
fn a_soft_actor_critic_sees_a_small_grid_by_the_encoder_of_the_policy() {
    let task = "[task]\nname = \"sliding\"\naction.continuous.len = 2\nhorizon_steps = 20\n\
                observation.cells = { height = 5, width = 5, classes = 3 }\n";
    let settings = [
        "method=sqil",
        "policy.convolution_channels=[4]",
        "policy.pool=1",
        "policy.features=8",
        "sqil.hidden=[8]",
        "sqil.batch=4",
        "sqil.exploration_steps=0",
    ];
    let config = run::tasks::of_text(task, "sliding", None, &settings.map(str::to_owned)).unwrap();
    let episode = Trajectory {
        steps: 10,
        cells: vec![1; 11 * 25].into(),
        continuous_actions: vec![0; 10 * 8].into(),
        ..Trajectory::default()
    };
    let (mut learner, mut policy) = algorithm::create(&config, std::slice::from_ref(&episode));
    let before = policy.parameters.clone();
    let batch = [Encoded::encode(episode)];
    let metrics = learner.update(&mut policy, &batch, &[], &schedule(&config, 0)).unwrap();
    assert!(metrics.value_loss > 0.0 && policy.parameters != before, "{metrics:?}");
}

/// Returns the action of an expert that goes to the middle of a line.
fn expert(place: f32) -> f32 {
    -0.8 * place
}

fn point(place: f32) -> Vec<u8> {
    let mut bytes = vec![0; 64];
    write_floats([place], &mut bytes[..4]);
    bytes
}

/// Returns an episode of ten steps on a line; each step is a fifth of the action's first number.
fn line(from: f32, source: Source, mut act: impl FnMut(f32) -> f32) -> Trajectory {
    let (mut place, mut values, mut actions) = (from, point(from), Vec::new());
    for _ in 0..10 {
        let action = act(place);
        place += 0.2 * action;
        values.extend(point(place));
        actions.extend([action, 0.0, 0.0].map(f32::to_le_bytes).concat());
    }
    let log_probs = if source == Source::Demonstration { 0 } else { 40 };
    Trajectory {
        task: "fetch-push".to_owned(),
        source: source as i32,
        steps: 10,
        observation_shape: vec![16],
        values: values.into(),
        continuous_actions: actions.into(),
        log_probs: vec![0; log_probs].into(),
        ending: Ending::Truncated as i32,
        ..Trajectory::default()
    }
}

/// Returns twenty episodes of ten steps on a line, of an agent that acts at random.
fn line_at_random(draws: &mut Stream) -> Vec<Encoded> {
    let episode = |_| {
        let from = draws.random_range(-1.0..1.0);
        Encoded::encode(line(from, Source::Training, |_| draws.random_range(-1.0..1.0)))
    };
    (0..20).map(episode).collect()
}

#[test]
fn threads_change_no_bit_and_a_restored_learner_goes_on_alike() {
    let bc = small("bc", &["cloning.batch=16"]);
    for (config, world) in [
        (bc, World::corridor()),
        (bco(), World::corridor()),
        (sqil(), World::corridor()),
        (soft_actor_critic(), World::line()),
    ] {
        let name = format!("{} on {}", config.method, config.task.name);
        let (one, policy) = world.train(&config, 6, 1);
        let (_, same) = world.train(&config, 6, 3);
        assert_eq!(policy.parameters, same.parameters, "{name}");
        let mut tensors = Tensors::default();
        one.save(&mut tensors);
        let (mut restored, _) = algorithm::create(&config, &world.demonstrations);
        restored.restore(&tensors).unwrap();
        if config.learner.replays() {
            (0..6).for_each(|iteration| restored.remember(&world.batch(iteration)));
        }
        let mut policies = [policy.clone(), policy.clone()];
        for (mut learner, after) in [one, restored].into_iter().zip(&mut policies) {
            learner.update(after, &world.batch(6), &[], &schedule(&config, 6)).unwrap();
        }
        assert_ne!(policies[0].parameters, policy.parameters, "{name}");
        assert_eq!(policies[0].parameters, policies[1].parameters, "{name}");
    }
}

#[test]
fn a_foreign_checkpoint_is_refused_with_the_array_that_differs() {
    let (mut learner, _) = algorithm::create(&bco(), &Corridor::demonstrations());
    let mut tensors = Tensors::default();
    learner.save(&mut tensors);
    tensors.put_f32("inverse.parameters", [1.0]);
    let message = learner.restore(&tensors).unwrap_err();
    assert!(message.contains("inverse.parameters") && message.contains("found 1"), "{message}");
}
