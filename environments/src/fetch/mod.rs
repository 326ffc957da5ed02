//! Fetch Pick and Fetch Push: a gripper brings a cube to a goal (paper, Section 4.4 and Table 1).
//!
//! A cube of 5 cm and 2 kg lies on a table; the gripper starts between it and the goal. In Fetch Pick the goal is in
//! the air, 0.15 m above that of Fetch Push, and the cube has to be grasped and carried. In Fetch Push the goal is on
//! the table and the fingers stay closed. For every episode cube and goal are drawn from the rectangles of the
//! [`FetchSetting`]. The robot is Gym's Fetch, whatever name the paper gives it; its arm is reduced to what moves the
//! gripper.
//!
//! # Action
//! Four numbers in Fetch Pick, three in Fetch Push, multiplied by the scale of the [`FetchSetting`] and clipped to
//! [-1, 1]. They act for 0.04 s. The palm lags behind its target: an action of 1 moves it 3 cm.
//!
//! | index | meaning | value of 1 |
//! |---|---|---|
//! | 0 to 2 | target of the palm along x, y, z, relative to its position | 0.05 m |
//! | 3 | target of each finger outward, relative to its position; Fetch Pick only | 1 m |
//!
//! # Observation
//! 16 numbers without velocities: lengths along the world's axes, and two angles.
//!
//! | index | meaning | unit |
//! |---|---|---|
//! | 0 to 2 | position of the grip site, between the fingertips | m |
//! | 3 to 5 | position of the cube's center | m |
//! | 6 to 8 | the cube's position minus the grip site's | m |
//! | 9, 10 | openings of the right and the left finger, 0 to 0.05 | m |
//! | 11, 12 | rotations of the cube about x and y, as Euler angles x, y, z | rad |
//! | 13 to 15 | position of the goal | m |
//!
//! # Ending, success and reward
//! A step succeeds if the cube's center is then within 0.05 m of the goal. Success terminates the episode, unless
//! [`end_at_goal`](FetchSetting::end_at_goal) is off; otherwise the episode is truncated at step 50 in Fetch Pick and
//! at step 60 in Fetch Push. The environment's own reward is that of Gym's Fetch tasks: 0 for a step that ends with
//! the cube at the goal, -1 for every other step.

mod expert;
mod observation;
mod sampling;
mod scene;

use crate::{Environment, EnvironmentError, Pose, Setting, Solid, Step, action};
use expert::{Expert, View};
use protocol::seed::Stream;
use protocol::task::{ActionSpec, ObservationSpec, Spec, write_floats};
use rapier3d::prelude::Vector;
use sampling::Sampling;
use scene::{GOAL_RADIUS, Scene};
use serde::{Deserialize, Serialize};
use xxhash_rust::xxh3::Xxh3;

/// Distance between the palm and its target at an action of 1, meters.
const PALM_REACH: f32 = 0.05;
/// Height of the goal in Fetch Push, meters: that of a cube at rest in Gym's softer physics.
const PUSH_GOAL_HEIGHT: f32 = 0.4247;
/// Height of the goal in Fetch Pick, meters: 0.15 m above that in Fetch Push.
const PICK_GOAL_HEIGHT: f32 = 0.5747;

/// One of the two Fetch tasks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FetchTask {
    /// The goal is in the air: the task `fetch-pick`.
    Pick,
    /// The goal is on the table: the task `fetch-push`.
    Push,
}

impl FetchTask {
    /// Returns the shapes of the task.
    pub const fn spec(self) -> Spec {
        let (len, horizon_steps) = match self {
            FetchTask::Pick => (4, 50),
            FetchTask::Push => (3, 60),
        };
        let observation = ObservationSpec::Vector { len: 16 };
        Spec { observation, action: ActionSpec::Continuous { len }, horizon_steps }
    }

    const fn action_numbers(self) -> usize {
        self.spec().action.bytes() / 4
    }
}

/// The setting of the Fetch tasks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FetchSetting {
    /// Fraction of the bins that cubes and goals are drawn from: 0.25, 0.5, 0.75 or 1.
    pub coverage: f64,
    /// Factor by which the ranges are stretched; 1 for the demonstrations.
    pub noise: f64,
    /// The ranges of cubes and goals around their centers.
    pub ranges: Ranges,
    /// Factor for each number of an action; empty for a scale of one.
    pub action_scale: Vec<f64>,
    /// Whether the cube at the goal ends an episode. Otherwise the episode goes on to the horizon, as with a robot
    /// that cannot detect success.
    pub end_at_goal: bool,
}

/// The ranges of cubes and goals around their centers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Ranges {
    /// To both sides of the center, as in the paper.
    #[default]
    Symmetric,
    /// Away from the gripper only, as in the authors' code.
    OneSided,
}

impl Default for FetchSetting {
    fn default() -> Self {
        let ranges = Ranges::default();
        FetchSetting {
            coverage: 1.0,
            noise: 1.0,
            ranges,
            action_scale: Vec::new(),
            end_at_goal: true,
        }
    }
}

/// The environment of the tasks `fetch-pick` and `fetch-push`.
pub struct Fetch {
    task: FetchTask,
    setting: FetchSetting,
    scale: action::ActionScale,
    sampling: Sampling,
    scene: Scene,
    expert: Expert,
    goal: Vector,
    /// Number of steps taken in the episode.
    steps: u32,
    /// Whether an episode has begun and not ended.
    running: bool,
    /// Whether the cube has reached the goal in the episode.
    success: bool,
}

impl Fetch {
    /// Builds the environment of one of the two tasks; its first episode begins with a reset.
    ///
    /// # Errors
    /// When a value of the setting is out of its range.
    pub fn new(task: FetchTask, setting: FetchSetting) -> Result<Fetch, EnvironmentError> {
        Ok(Fetch {
            task,
            scale: action::ActionScale::new(&setting.action_scale, task.action_numbers())?,
            sampling: Sampling::new(task, &setting)?,
            setting,
            scene: Scene::new(grip_start(task)),
            expert: Expert::new(task),
            goal: Vector::ZERO,
            steps: 0,
            running: false,
            success: false,
        })
    }

    fn observe(&self, observation: &mut [u8]) -> Result<(), EnvironmentError> {
        self.scene.check_finite(self.steps)?;
        observation::write(&self.scene, self.goal, observation);
        Ok(())
    }
}

/// Returns the position of the grip site at the start of an episode. In Gym, Push's fingers are pressed 5 mm into a
/// soft table; here they stand on it.
fn grip_start(task: FetchTask) -> Vector {
    match task {
        FetchTask::Push => Vector::new(1.3455, 0.7490, 0.4186),
        FetchTask::Pick => Vector::new(1.3419, 0.7491, 0.5347),
    }
}

impl Environment for Fetch {
    fn spec(&self) -> Spec {
        self.task.spec()
    }

    fn setting(&self) -> Setting {
        Setting::of(&self.setting)
    }

    fn reset(
        &mut self,
        stream: &mut Stream,
        observation: &mut [u8],
    ) -> Result<(), EnvironmentError> {
        let start = grip_start(self.task);
        let ([cube_x, cube_y], [goal_x, goal_y]) = self.sampling.draw(stream);
        let goal_z = match self.task {
            FetchTask::Push => PUSH_GOAL_HEIGHT,
            FetchTask::Pick => PICK_GOAL_HEIGHT,
        };
        self.goal = Vector::new(start.x + goal_x, start.y + goal_y, goal_z);
        self.scene.reset([start.x + cube_x, start.y + cube_y]);
        self.expert = Expert::new(self.task);
        self.steps = 0;
        self.running = false;
        self.success = false;
        self.observe(observation)?;
        self.running = true;
        Ok(())
    }

    fn step(&mut self, action: &[u8], observation: &mut [u8]) -> Result<Step, EnvironmentError> {
        let spec = self.spec();
        action::check_action(&spec, self.running, action)?;
        let [x, y, z, fingers] = self.scale.clipped(action);
        self.scene.pull_palm([x, y, z].map(|number| PALM_REACH * number));
        if self.task == FetchTask::Pick {
            self.scene.pull_fingers(fingers);
        }
        self.scene.simulate();
        self.steps += 1;
        // An episode whose physics fails is over.
        self.running = false;
        self.observe(observation)?;

        let at_goal = self.scene.cube().distance(self.goal) < GOAL_RADIUS;
        self.success |= at_goal;
        let ending = spec.ending(at_goal && self.setting.end_at_goal, self.steps);
        self.running = ending.is_none();
        Ok(Step { reward: if at_goal { 0.0 } else { -1.0 }, ending, success: self.success })
    }

    fn expert_action(&mut self, action: &mut [u8]) -> Result<bool, EnvironmentError> {
        assert_eq!(action.len(), self.spec().action.bytes(), "the caller sizes the action");
        if !self.running {
            return Ok(false);
        }
        let numbers = self.expert.action(&View {
            grip: self.scene.grip(),
            grip_start: grip_start(self.task),
            fingers: self.scene.fingers(),
            cube: self.scene.cube(),
            goal: self.goal,
        });
        write_floats(
            self.scale.unscaled(numbers.into_iter()).take(self.task.action_numbers()),
            action,
        );
        Ok(true)
    }

    fn state_hash(&self) -> u64 {
        let mut hasher = Xxh3::new();
        self.scene.hash(&mut hasher);
        for number in self.goal.to_array() {
            hasher.update(&number.to_le_bytes());
        }
        hasher.update(&self.steps.to_le_bytes());
        // 2 where the goal was reached and the episode goes on.
        hasher.update(&[u8::from(self.running) + u8::from(self.running && self.success)]);
        hasher.digest()
    }

    fn solids(&self) -> &[Solid] {
        &scene::SOLIDS
    }

    fn append_poses(&self, poses: &mut Vec<Pose>) {
        self.scene.append_poses(self.goal, poses);
    }
}
