//! Ant Reach: a quadruped walks to a goal five meters away (paper, Section 4.5 and Table 1).
//!
//! The ant starts at the origin. For every episode the goal is drawn on the half circle of radius five meters where y
//! is not negative. The half circle has twenty sectors of nine degrees; the coverage of an [`AntSetting`] is the
//! fraction of them that is kept, spread evenly. Its noise is half the width of a uniform distribution that is added
//! to every coordinate of the starting pose; starting velocities always lie within 0.005 of zero.
//!
//! # Action
//! Eight numbers, multiplied by the scale of the [`AntSetting`] and clipped to [-1, 1]. Each drives one joint with up
//! to 150 newton meters for 0.1 s, which is five timesteps.
//!
//! | index | joints | the leg points toward |
//! |---|---|---|
//! | 0, 1 | hip and ankle of leg 4 | +x, -y |
//! | 2, 3 | hip and ankle of leg 1 | +x, +y |
//! | 4, 5 | hip and ankle of leg 2 | -x, +y |
//! | 6, 7 | hip and ankle of leg 3 | -x, -y |
//!
//! # Observation
//! 132 numbers. Joints are in the order of the legs, the hip before the ankle; quaternions have the scalar first. The
//! authors' goal is a body that falls; here it is a fixed mark.
//!
//! | index | meaning | unit |
//! |---|---|---|
//! | 0 | height of the torso's center | m |
//! | 1 to 4 | orientation of the torso, a unit quaternion w, x, y, z | |
//! | 5 to 12 | angles of the joints | rad |
//! | 13 to 15 | position of the goal's mark in the world | m |
//! | 16 to 19 | orientation of the goal's mark, a unit quaternion w, x, y, z | |
//! | 20 to 22 | velocity of the torso in the world | m/s |
//! | 23 to 25 | angular velocity of the torso about its own axes | rad/s |
//! | 26 to 33 | angular velocities of the joints | rad/s |
//! | 34 to 39 | velocities of the goal's mark, always 0 | |
//! | 40 to 129 | torque and force of the floor on 15 bodies, clipped to [-1, 1] | N m, N |
//! | 130, 131 | displacement from the torso to the goal along x and y | m |
//!
//! The contact forces are zeros unless the [`AntSetting`] asks for them; they were zeros in the authors' runs. Their
//! rows are the bodies of the authors' model: the world, the torso, then hip, leg and foot of each leg, then the goal;
//! nothing acts on the first and the last. Torques are about the ant's center of mass. Torques and forces are along
//! the world's axes, averaged over the last timestep.
//!
//! # Ending, success and reward
//! Every episode is truncated at step 50. It succeeds if after any step the torso is within half a meter of the goal
//! in the xy plane. The environment's own reward is `1 - d / 5 - 0.005 a²`, where `d` is the distance to the goal
//! after the step and `a` is the action as given, neither scaled nor clipped. There is no scripted expert; [`EXPERT`]
//! was trained on this reward.

mod anatomy;
mod body;
mod contact;
mod observation;
mod sampling;
mod solids;

use crate::physics::Physics;
use crate::{Environment, EnvironmentError, Expert, Pose, Setting, Solid, Step, action};
use anatomy::{JOINTS, State};
use body::Body;
use observation::Goal;
use protocol::error::within;
use protocol::seed::Stream;
use protocol::task::{ActionSpec, ObservationSpec, Spec, floats};
use sampling::{GOAL_DISTANCE, Sampling};
use serde::{Deserialize, Serialize};
use xxhash_rust::xxh3::Xxh3;

/// Number of timesteps in a step.
const TIMESTEPS: usize = 5;
/// Torque on a joint at an action of 1, newton meters.
const GEAR: f32 = 150.0;
/// Weight of the squared action in the reward.
const ACTION_COST: f32 = 0.005;
/// Distance between torso and goal below which an episode succeeds, meters.
const SUCCESS_DISTANCE: f32 = 0.5;
/// The joint that each number of an action drives.
const ACTUATED: [usize; JOINTS] = [6, 7, 0, 1, 2, 3, 4, 5];

/// The shapes of the task.
pub const SPEC: Spec = Spec {
    observation: ObservationSpec::Vector { len: 132 },
    action: ActionSpec::Continuous { len: JOINTS },
    horizon_steps: 50,
};

/// The expert of the task; `environments/experts/README.md` has the command that trained it.
pub const EXPERT: Expert = Expert::Policy {
    config: include_str!("../../experts/ant_reach/config.toml"),
    weights: include_bytes!("../../experts/ant_reach/policy.safetensors"),
};

/// Largest noise on the starting pose.
const NOISE_MAX: f64 = 0.5;

/// The setting of Ant Reach.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AntSetting {
    /// Fraction of the half circle that goals lie on, above 0 and at most 1.
    pub coverage: f64,
    /// Half the width of the uniform noise on the starting pose, meters and radians; 0 for the
    /// demonstrations.
    pub noise: f64,
    /// Whether the noise also applies to the height and orientation of the goal's mark. It does in the authors' code;
    /// in the paper only the ant's pose is noisy. This noise distinguishes the agent's states from demonstrations
    /// without noise, whatever the agent does.
    pub mark_noise: bool,
    /// Whether contact forces are observed. Otherwise they are zeros, as in the authors' runs.
    pub contact_forces: bool,
    /// Factor for each number of an action; empty for a scale of one.
    pub action_scale: Vec<f64>,
}

impl Default for AntSetting {
    fn default() -> Self {
        AntSetting {
            coverage: 1.0,
            noise: 0.0,
            mark_noise: false,
            contact_forces: false,
            action_scale: Vec::new(),
        }
    }
}

impl AntSetting {
    fn check(&self) -> Result<(), protocol::Error> {
        let &AntSetting { coverage, noise, .. } = self;
        let covers = coverage > 0.0 && coverage <= 1.0;
        within("coverage", covers, "above 0 and at most 1", coverage)?;
        let expected = format!("0 to {NOISE_MAX}");
        within("noise", (0.0..=NOISE_MAX).contains(&noise), &expected, noise)
    }
}

/// The environment of the task `ant-reach`.
pub struct Ant {
    setting: AntSetting,
    physics: Physics,
    body: Body,
    sampling: Sampling,
    scale: action::ActionScale,
    goal: Goal,
    /// Number of steps taken in the episode.
    steps: u32,
    /// Whether an episode has begun and not ended.
    running: bool,
    /// Whether the goal has been reached in the episode.
    success: bool,
}

impl Ant {
    /// Builds the environment; its first episode begins with a reset.
    ///
    /// # Errors
    /// When a value of the setting is out of its range.
    pub fn new(setting: AntSetting) -> Result<Ant, EnvironmentError> {
        setting.check()?;
        let scale = action::ActionScale::new(&setting.action_scale, JOINTS)?;
        let (physics, body) = body::build();
        Ok(Ant {
            physics,
            body,
            sampling: Sampling::new(&setting),
            setting,
            scale,
            goal: Goal::NOWHERE,
            steps: 0,
            running: false,
            success: false,
        })
    }

    /// Applies an action for the duration of a step.
    fn act(&mut self, action: &[f32; JOINTS]) {
        let mut torques = [0.0; JOINTS];
        for (joint, number) in ACTUATED.into_iter().zip(action) {
            torques[joint] = GEAR * number;
        }
        for _ in 0..TIMESTEPS {
            self.body.drive(&mut self.physics.world, &torques);
            self.physics.step();
        }
    }

    /// Checks the state, writes its observation and returns it.
    fn observe(&self, observation: &mut [u8]) -> Result<State, EnvironmentError> {
        self.physics.check_finite(self.steps)?;
        let world = &self.physics.world;
        let state = self.body.state(world);
        let forces = match self.setting.contact_forces {
            true => contact::forces(world, &self.body),
            false => contact::NONE,
        };
        observation::write(&state, &self.goal, &forces, observation);
        Ok(state)
    }
}

impl Environment for Ant {
    fn spec(&self) -> Spec {
        SPEC
    }

    fn setting(&self) -> Setting {
        Setting::of(&self.setting)
    }

    fn reset(
        &mut self,
        stream: &mut Stream,
        observation: &mut [u8],
    ) -> Result<(), EnvironmentError> {
        let (start, goal) = self.sampling.draw(stream);
        self.goal = goal;
        self.steps = 0;
        self.success = false;
        self.running = false;
        self.physics.restore();
        self.body.place(&mut self.physics.world, &start);
        self.observe(observation)?;
        self.running = true;
        Ok(())
    }

    fn step(&mut self, action: &[u8], observation: &mut [u8]) -> Result<Step, EnvironmentError> {
        let spec = self.spec();
        action::check_action(&spec, self.running, action)?;
        self.act(&self.scale.clipped(action));
        self.steps += 1;
        // An episode whose physics fails is over.
        self.running = false;
        let state = self.observe(observation)?;

        let [x, y] = self.goal.from(state.position);
        let distance = (x * x + y * y).sqrt();
        self.success |= distance < SUCCESS_DISTANCE;
        // Reaching the goal never ends an episode of this task.
        let ending = spec.ending(false, self.steps);
        self.running = ending.is_none();
        let effort: f32 = floats(action).map(|number| number * number).sum();
        let reward = 1.0 - distance / GOAL_DISTANCE - ACTION_COST * effort;
        Ok(Step { reward, ending, success: self.success })
    }

    fn state_hash(&self) -> u64 {
        let mut hasher = Xxh3::new();
        self.physics.hash(&mut hasher);
        let Goal { position, orientation } = self.goal;
        for number in position.to_array().into_iter().chain(orientation.to_array()) {
            hasher.update(&number.to_le_bytes());
        }
        hasher.update(&self.steps.to_le_bytes());
        hasher.update(&[u8::from(self.running), u8::from(self.success)]);
        hasher.digest()
    }

    fn solids(&self) -> &[Solid] {
        &solids::SOLIDS
    }

    fn append_poses(&self, poses: &mut Vec<Pose>) {
        solids::append_poses(&self.physics.world, &self.body, &self.goal, poses);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::seed::{Purpose, stream};
    use protocol::task::write_floats;

    /// Begins an episode; returns the environment and a buffer with the first observation.
    fn begun() -> (Ant, Vec<u8>) {
        let mut ant = Ant::new(AntSetting::default()).expect("the default setting");
        let mut observation = vec![0; ant.spec().observation.bytes()];
        ant.reset(&mut stream(1, Purpose::TrainingEpisode, 0, 0), &mut observation).expect("reset");
        (ant, observation)
    }

    /// Places the ant `distance` meters from the goal, at a smaller x.
    fn stand_at(ant: &mut Ant, distance: f32) {
        let mut state = State::start();
        state.position.x = ant.goal.position.x - distance;
        state.position.y = ant.goal.position.y;
        ant.body.place(&mut ant.physics.world, &state);
    }

    #[test]
    fn success_stays_when_the_goal_is_left() {
        let (mut ant, mut observation) = begun();
        let rest = [0; 4 * JOINTS];
        let mut successes = Vec::new();
        for distance in [0.6, 0.45, 0.6, 4.0] {
            stand_at(&mut ant, distance);
            let step = ant.step(&rest, &mut observation).expect("a step");
            assert_eq!(step.ending, None, "success ends nothing");
            assert!((step.reward - (1.0 - distance / 5.0)).abs() < 0.01, "{step:?} at {distance}");
            successes.push(step.success);
        }
        assert_eq!(successes, [false, true, true, true]);
        ant.reset(&mut stream(1, Purpose::TrainingEpisode, 0, 1), &mut observation).expect("reset");
        assert!(!ant.step(&rest, &mut observation).expect("a step").success, "a new episode");
    }

    #[test]
    fn physics_that_fails_ends_the_episode() {
        let (mut ant, mut observation) = begun();
        let torso = ant.body.links[0];
        ant.physics.world.bodies[torso].add_force(rapier3d::prelude::Vector::X * f32::MAX, true);
        let mut action = [0; 4 * JOINTS];
        write_floats([1.0; JOINTS], &mut action);
        let error = ant.step(&action, &mut observation).expect_err("an infinite force");
        assert!(error.to_string().starts_with("expected finite numbers"), "{error}");
        let refused = Err(EnvironmentError::NotRunning);
        assert_eq!(ant.step(&action, &mut observation), refused);
    }

    #[test]
    fn solids_have_poses_and_names_of_their_own() {
        let (ant, _) = begun();
        let mut poses = Vec::new();
        ant.append_poses(&mut poses);
        assert_eq!(poses.len(), ant.solids().len());
        let named = |name| {
            let index = ant.solids().iter().position(|solid| solid.name == name);
            poses[index.expect("a solid of that name")]
        };
        assert_eq!(named("torso").position, [0.0, 0.0, 0.55]);
        assert_eq!(named("goal").position[..2], ant.goal.position.to_array()[..2]);
        // The middle of the foot of leg 3, lowered by one radian.
        let [x, y, z] = named("foot 3").position;
        let along = 0.4 + 0.2 * libm::cosf(1.0);
        let expected = [-along, -along, 0.55 - 0.08_f32.sqrt() * libm::sinf(1.0)];
        for (found, expected) in [x, y, z].into_iter().zip(expected) {
            assert!((found - expected).abs() < 1e-4, "{found} instead of {expected}");
        }
        let names: std::collections::BTreeSet<_> = ant.solids().iter().map(|it| it.name).collect();
        assert_eq!(names.len(), ant.solids().len());
    }
}
