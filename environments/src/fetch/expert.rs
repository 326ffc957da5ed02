//! The scripted experts of both tasks (paper, Section 4.4, after the authors' code).
//!
//! A script is a sequence of stages. In each stage the action is six times the displacement, in meters, from the grip
//! site to its target; the environment clips it. Every stage except the last ends within half a centimeter of its
//! target; the descent also ends when the fingers hold the cube. The current stage affects nothing except the expert's
//! own actions.
//!
//! | task | stages |
//! |---|---|
//! | Fetch Pick | above the cube with open fingers; down around it while they close; carry it to the goal |
//! | Fetch Push | up; above a point behind the cube, seen from the goal; down; push toward the goal |

use super::FetchTask;
use rapier3d::prelude::Vector;

/// Action per meter of displacement.
const GAIN: f32 = 6.0;
/// Distance from the target at which every stage except the last ends, meters.
const TOLERANCE: f32 = 0.005;

/// Offset from the cube to the grip site before the gripper descends, meters.
const HOVER: Vector = Vector::new(0.0, 0.0, 0.03);
/// Action that opens the fingers in three steps.
const OPEN: f32 = 0.05;
/// Action that closes the fingers in about ten steps and then holds the cube.
const CLOSE: f32 = -0.005;
/// Sum of the openings of both fingers below which they hold the cube, meters.
const HELD: f32 = 0.0485;
/// Distance to the goal at which the expert stops moving the cube, meters.
const ARRIVED: f32 = 0.01;

/// How far the gripper rises before it moves behind the cube, meters.
const LIFT: Vector = Vector::new(0.0, 0.0, 0.08);
/// Distance behind the cube, seen from the goal, at which pushing begins, meters.
const RUN_UP: f32 = 0.1;

/// The part of the state that an expert sees.
pub(super) struct View {
    pub(super) grip: Vector,
    /// Position of the grip site at the start of the episode.
    pub(super) grip_start: Vector,
    /// Openings of the right and the left finger, meters.
    pub(super) fingers: [f32; 2],
    pub(super) cube: Vector,
    pub(super) goal: Vector,
}

/// A script and its current stage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Expert {
    stage: Stage,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Stage {
    /// Pick: move above the cube with open fingers.
    Approach,
    /// Pick: move down around the cube while the fingers close.
    Descend,
    /// Pick: carry the cube to the goal.
    Carry,
    /// Push: rise from the table.
    Rise,
    /// Push: move above the point where pushing begins.
    Behind,
    /// Push: move down to the table.
    Lower,
    /// Push: move the gripper toward the goal, pushing the cube ahead of it.
    Push,
}

impl Expert {
    pub(super) fn new(task: FetchTask) -> Expert {
        let stage = if task == FetchTask::Push { Stage::Rise } else { Stage::Approach };
        Expert { stage }
    }

    /// Returns the expert's action: three numbers for the palm and one for the fingers.
    pub(super) fn action(&mut self, view: &View) -> [f32; 4] {
        while let Some(next) = self.stage.next(view) {
            self.stage = next;
        }
        let rest = self.stage.rest(view);
        let motion = match self.stage {
            Stage::Carry if rest.length() < ARRIVED => Vector::ZERO,
            _ => rest * GAIN,
        };
        [motion.x, motion.y, motion.z, self.stage.fingers()]
    }
}

impl Stage {
    /// Returns the remaining displacement of the grip site, or in the stage `Carry` of the cube.
    fn rest(self, view: &View) -> Vector {
        let View { grip, grip_start, cube, goal, .. } = *view;
        match self {
            Stage::Approach => cube + HOVER - grip,
            Stage::Descend => cube - grip,
            Stage::Carry => goal - cube,
            Stage::Rise => grip_start + LIFT - grip,
            Stage::Behind => behind(view) + LIFT - grip,
            Stage::Lower => behind(view) - grip,
            Stage::Push => goal - grip,
        }
    }

    fn fingers(self) -> f32 {
        match self {
            Stage::Approach => OPEN,
            Stage::Descend | Stage::Carry => CLOSE,
            Stage::Rise | Stage::Behind | Stage::Lower | Stage::Push => 0.0,
        }
    }

    /// Returns the next stage if this one is over.
    fn next(self, view: &View) -> Option<Stage> {
        let next = match self {
            Stage::Approach => Stage::Descend,
            Stage::Descend => Stage::Carry,
            Stage::Rise => Stage::Behind,
            Stage::Behind => Stage::Lower,
            Stage::Lower => Stage::Push,
            Stage::Carry | Stage::Push => return None,
        };
        // Fingers that touch the cube keep the palm from sliding down any farther.
        let held = self == Stage::Descend && view.fingers.iter().sum::<f32>() < HELD;
        (held || self.rest(view).length() < TOLERANCE).then_some(next)
    }
}

/// Returns the point behind the cube where pushing begins, at the gripper's starting height.
fn behind(view: &View) -> Vector {
    let away = view.cube - view.goal;
    let away = Vector::new(away.x, away.y, 0.0).normalize_or_zero();
    let point = view.cube + away * RUN_UP;
    Vector::new(point.x, point.y, view.grip_start.z)
}
