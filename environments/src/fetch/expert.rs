//! The scripted experts of both tasks (Section 4.4, after the authors' code).
//!
//! A script is a row of stages. Each stage pulls the grip site toward its target with an action of
//! six times the distance in meters, and all but the last are over within half a centimeter of it;
//! what passes 1 is left to the environment to clip. Where in its script the expert is changes
//! nothing but the expert's own actions.
//!
//! | task | stages |
//! |---|---|
//! | Fetch Pick | with open fingers over the cube; down around it while the fingers close; the cube to the goal |
//! | Fetch Push | up; over a point behind the cube, seen from the goal; down; the gripper to the goal |

use super::FetchTask;
use rapier3d::prelude::Vector;

/// Action for every meter of distance.
const GAIN: f32 = 6.0;
/// Distance at which a stage before the last is over, meters.
const TOLERANCE: f32 = 0.005;

/// Where the gripper stops over the cube before it comes down on it.
const HOVER: Vector = Vector::new(0.0, 0.0, 0.03);
/// Action of the fingers that opens them in three steps.
const OPEN: f32 = 0.05;
/// Action of the fingers that closes them in about ten steps, and then holds the cube.
const CLOSE: f32 = -0.005;
/// Sum of how far the fingers are open below which they have the cube between them, meters.
const HELD: f32 = 0.0485;
/// Distance from the goal at which the cube is left where it is.
const ARRIVED: f32 = 0.01;

/// How high the gripper moves over the table before it pushes.
const LIFT: Vector = Vector::new(0.0, 0.0, 0.08);
/// Where pushing begins: this far behind the cube, seen from the goal.
const RUN_UP: f32 = 0.1;

/// What an expert knows of the state.
pub(super) struct View {
    pub(super) grip: Vector,
    /// Where the grip site was when the episode began.
    pub(super) grip_start: Vector,
    /// How far the right and the left finger are open.
    pub(super) fingers: [f32; 2],
    pub(super) cube: Vector,
    pub(super) goal: Vector,
}

/// A script, and how far it has come.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Expert {
    stage: Stage,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Stage {
    /// Pick: over the cube with open fingers.
    Approach,
    /// Pick: down around the cube while the fingers close.
    Descend,
    /// Pick: carry the cube to the goal.
    Carry,
    /// Push: up from the table.
    Rise,
    /// Push: over the point that pushing begins at.
    Behind,
    /// Push: down to the table.
    Lower,
    /// Push: the gripper to the goal, and the cube before it.
    Push,
}

impl Expert {
    pub(super) fn new(task: FetchTask) -> Expert {
        let stage = if task == FetchTask::Push { Stage::Rise } else { Stage::Approach };
        Expert { stage }
    }

    /// What the expert does: three numbers for the palm and one for the fingers.
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
    /// The way the grip site, or the cube in it, still has to go.
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

    /// The stage that follows, if this one is over.
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

/// The point behind the cube at the height that the gripper started from.
fn behind(view: &View) -> Vector {
    let away = view.cube - view.goal;
    let away = Vector::new(away.x, away.y, 0.0).normalize_or_zero();
    let point = view.cube + away * RUN_UP;
    Vector::new(point.x, point.y, view.grip_start.z)
}
