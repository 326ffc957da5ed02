//! Reacher: an arm of two links turns its joints until its tip is at a point of the plane.
//!
//! # Action
//! Two numbers, clipped to [-1, 1]: how fast the shoulder and the elbow turn, 1 being 0.2 rad a step.
//!
//! # Observation
//! | index | meaning |
//! |---|---|
//! | 0 to 3 | cosine and sine of the shoulder's angle, then of the elbow's |
//! | 4, 5 | the goal, meters |
//! | 6, 7 | from the tip to the goal, meters |
//!
//! # Ending, success and reward
//! In `reacher` the tip within 5 cm of the goal is success and ends the episode; step 60 cuts it. In
//! `reacher-held` every episode lasts 60 steps and nobody says whether it went well. The environment's
//! own reward is minus the distance.

use std::f32::consts::PI;
use std::thread;
use std::time::Duration;

use actor::{Environment, EnvironmentError, Setting, Step, check_action};
use protocol::error::within;
use protocol::seed::Stream;
use protocol::task::{ActionSpec, ObservationSpec, Spec, floats, write_floats};
use rand::RngExt;
use serde::{Deserialize, Serialize};

const SPEC: Spec = Spec {
    observation: ObservationSpec::Vector { len: 8 },
    action: ActionSpec::Continuous { len: 2 },
    horizon_steps: 60,
};

/// Length of each link, meters.
const LINK: f32 = 0.5;

/// How far a joint turns in a step at an action of one, radians.
const TURN: f32 = 0.2;

/// How near the tip must come, meters.
const NEAR: f32 = 0.05;

/// What becomes of an episode whose tip is at the goal.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Goal {
    /// It ends with success.
    EndsEpisode,
    /// It goes on, and success is not told.
    IsHeld,
}

/// What the environment is made with: the keys of `[environment]` in the task's file.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct ReacherSetting {
    /// The part of the circle around the shoulder that goals lie in, above 0 and at most 1.
    coverage: f64,
    /// How long a step waits, milliseconds, as in a simulator that is slow; 0 to 1,000.
    step_ms: f64,
}

impl Default for ReacherSetting {
    fn default() -> Self {
        ReacherSetting { coverage: 1.0, step_ms: 0.0 }
    }
}

/// The environment.
pub(crate) struct Reacher {
    at_goal: Goal,
    setting: ReacherSetting,
    /// Of shoulder and elbow, radians.
    angles: [f32; 2],
    goal: [f32; 2],
    steps: u32,
    running: bool,
}

impl Reacher {
    pub(crate) fn new(at_goal: Goal, setting: ReacherSetting) -> Result<Reacher, EnvironmentError> {
        let ReacherSetting { coverage, step_ms } = setting;
        within("coverage", coverage > 0.0 && coverage <= 1.0, "above 0 and at most 1", coverage)?;
        within("step_ms", (0.0..=1000.0).contains(&step_ms), "0 to 1000", step_ms)?;
        let (angles, goal) = ([0.0; 2], [0.0; 2]);
        Ok(Reacher { at_goal, setting, angles, goal, steps: 0, running: false })
    }

    fn to_goal(&self) -> [f32; 2] {
        let [x, y] = tip(self.angles);
        [self.goal[0] - x, self.goal[1] - y]
    }

    fn observe(&self, observation: &mut [u8]) {
        let [shoulder, elbow] = self.angles;
        let [goal_x, goal_y] = self.goal;
        let [x, y] = self.to_goal();
        let turned = [cos(shoulder), sin(shoulder), cos(elbow), sin(elbow)];
        write_floats(turned.into_iter().chain([goal_x, goal_y, x, y]), observation);
    }
}

impl Environment for Reacher {
    fn spec(&self) -> Spec {
        SPEC
    }

    fn setting(&self) -> Setting {
        Setting::of(&self.setting)
    }

    fn tells_success(&self) -> bool {
        self.at_goal == Goal::EndsEpisode
    }

    fn reset(
        &mut self,
        stream: &mut Stream,
        observation: &mut [u8],
    ) -> Result<(), EnvironmentError> {
        self.angles = [stream.random_range(-PI..PI), stream.random_range(-2.0..2.0)];
        loop {
            let toward = PI * self.setting.coverage as f32 * stream.random_range(-1.0..1.0f32);
            let far = stream.random_range(0.3..0.95f32);
            self.goal = [far * cos(toward), far * sin(toward)];
            if length(self.to_goal()) > 2.0 * NEAR {
                break;
            }
        }
        (self.steps, self.running) = (0, true);
        self.observe(observation);
        Ok(())
    }

    fn step(&mut self, action: &[u8], observation: &mut [u8]) -> Result<Step, EnvironmentError> {
        check_action(&SPEC, self.running, action)?;
        if self.setting.step_ms > 0.0 {
            thread::sleep(Duration::from_secs_f64(self.setting.step_ms / 1000.0));
        }
        for (angle, number) in self.angles.iter_mut().zip(floats(action)) {
            *angle += TURN * number.clamp(-1.0, 1.0);
        }
        self.steps += 1;
        self.observe(observation);
        let distance = length(self.to_goal());
        let success = self.at_goal == Goal::EndsEpisode && distance < NEAR;
        let ending = SPEC.ending(success, self.steps);
        self.running = ending.is_none();
        Ok(Step { reward: -distance, ending, success })
    }

    /// Turns the joints so that the tip moves straight toward the goal: damped least squares.
    fn expert_action(&mut self, action: &mut [u8]) -> Result<bool, EnvironmentError> {
        if !self.running {
            return Ok(false);
        }
        let [shoulder, elbow] = self.angles;
        let outer = [-LINK * sin(shoulder + elbow), LINK * cos(shoulder + elbow)];
        let inner = [outer[0] - LINK * sin(shoulder), outer[1] + LINK * cos(shoulder)];
        // The inverse of J Jᵀ + damping, times the way to the goal.
        let [x, y] = self.to_goal();
        let damping = 0.02;
        let a = inner[0] * inner[0] + outer[0] * outer[0] + damping;
        let b = inner[0] * inner[1] + outer[0] * outer[1];
        let d = inner[1] * inner[1] + outer[1] * outer[1] + damping;
        let determinant = a * d - b * b;
        let [x, y] = [(d * x - b * y) / determinant, (a * y - b * x) / determinant];
        let turns = [inner, outer].map(|column| 0.5 * (column[0] * x + column[1] * y) / TURN);
        write_floats(turns, action);
        Ok(true)
    }

    fn state_hash(&self) -> u64 {
        let numbers = [self.angles, self.goal].concat().into_iter().map(f32::to_bits);
        let all = numbers.chain([self.steps, u32::from(self.running)]);
        // FNV-1a.
        all.fold(0xcbf2_9ce4_8422_2325, |hash, bits| {
            (hash ^ u64::from(bits)).wrapping_mul(0x100_0000_01b3)
        })
    }
}

fn tip([shoulder, elbow]: [f32; 2]) -> [f32; 2] {
    let both = shoulder + elbow;
    [LINK * (cos(shoulder) + cos(both)), LINK * (sin(shoulder) + sin(both))]
}

fn length([x, y]: [f32; 2]) -> f32 {
    (x * x + y * y).sqrt()
}

// The system's own differ from machine to machine in their last bits, and with them a run's result.
fn cos(angle: f32) -> f32 {
    libm::cosf(angle)
}

fn sin(angle: f32) -> f32 {
    libm::sinf(angle)
}
