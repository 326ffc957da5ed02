//! What the ant is made of: a ball with four legs of three capsules each, after the authors'
//! MuJoCo model.
//!
//! | part | count | shape, meters | mass, kg | moved by |
//! |---|---|---|---|---|
//! | torso | 1 | ball, radius 0.25 | 0.327 | nothing, it is free |
//! | hip | 4 | capsule, radius 0.08, from the torso's center by (0.2, 0.2) | 0.039 | nothing, it is a part of the torso |
//! | leg | 4 | capsule, radius 0.08, onward by (0.2, 0.2) | 0.039 | its hip joint, about z |
//! | foot | 4 | capsule, radius 0.08, onward by (0.4, 0.4) | 0.068 | its ankle joint, about a diagonal |
//!
//! All distances are for a leg to the front left; [`Leg::toward`] turns them to the other corners.

use rapier3d::prelude::{Rotation, Vector};

/// Row of the torso among contact forces.
pub(super) const TORSO_ROW: usize = 1;

/// Rows of hip, leg and foot of a leg among contact forces.
pub(super) fn limb_rows(leg: usize) -> [usize; 3] {
    let hip = 2 + 3 * leg;
    [hip, hip + 1, hip + 2]
}

/// Number of hinges.
pub(super) const JOINTS: usize = 8;
/// Number of bodies that hinges hold together: the torso, four legs and four feet.
pub(super) const LINKS: usize = 9;
/// Density of every part, kilograms per cubic meter.
pub(super) const DENSITY: f32 = 5.0;
/// Radius of the torso, meters.
pub(super) const TORSO_RADIUS: f32 = 0.25;
/// Radius of every capsule, meters.
pub(super) const LIMB_RADIUS: f32 = 0.08;
/// Reach of a hip and of a leg along x and along y, meters.
pub(super) const SHORT_REACH: f32 = 0.2;
/// Reach of a foot along x and along y, meters.
pub(super) const LONG_REACH: f32 = 0.4;
/// How far a hip joint turns to both sides, radians.
pub(super) const HIP_LIMIT: f32 = 30_f32.to_radians();
/// Between what an ankle joint turns, radians, to the side that lowers its foot.
pub(super) const ANKLE_LIMITS: [f32; 2] = [30_f32.to_radians(), 70_f32.to_radians()];
/// Height of the torso's center at the start of an episode, meters.
pub(super) const START_HEIGHT: f32 = 0.55;

/// The names of the bodies, in the order of the links.
pub(super) const LINK_NAMES: [&str; LINKS] =
    ["torso", "leg 1", "foot 1", "leg 2", "foot 2", "leg 3", "foot 3", "leg 4", "foot 4"];

/// One leg.
pub(super) struct Leg {
    /// The signs of x and y in which it points away from the torso.
    pub(super) toward: [f32; 2],
    /// The signs of x and y of its ankle's axis.
    pub(super) ankle_axis: [f32; 2],
    /// The sign of the ankle's angle that lowers the foot.
    pub(super) ankle_side: f32,
}

/// The four legs: front left, front right, back left and back right.
pub(super) const LEGS: [Leg; 4] = [
    Leg { toward: [1.0, 1.0], ankle_axis: [-1.0, 1.0], ankle_side: 1.0 },
    Leg { toward: [-1.0, 1.0], ankle_axis: [1.0, 1.0], ankle_side: -1.0 },
    Leg { toward: [-1.0, -1.0], ankle_axis: [-1.0, 1.0], ankle_side: -1.0 },
    Leg { toward: [1.0, -1.0], ankle_axis: [1.0, 1.0], ankle_side: 1.0 },
];

impl Leg {
    /// The point that a capsule of such a reach ends at, from where it begins.
    pub(super) fn end(&self, reach: f32) -> Vector {
        Vector::new(self.toward[0] * reach, self.toward[1] * reach, 0.0)
    }

    /// The unit axis of the ankle, in the frame of the leg as in that of the foot.
    pub(super) fn ankle_axis(&self) -> Vector {
        Vector::new(self.ankle_axis[0], self.ankle_axis[1], 0.0).normalize()
    }

    /// The lowest and highest angle of the ankle, radians.
    pub(super) fn ankle_limits(&self) -> [f32; 2] {
        let [small, large] = ANKLE_LIMITS;
        if self.ankle_side > 0.0 { [small, large] } else { [-large, -small] }
    }
}

/// Where the ant is and how it moves, in the coordinates of the authors' simulator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct State {
    /// Center of the torso in the world, meters.
    pub(super) position: Vector,
    /// Turns the torso's axes into the world's.
    pub(super) orientation: Rotation,
    /// Angles of hip 1, ankle 1, hip 2 and so on to ankle 4, radians.
    pub(super) angles: [f32; JOINTS],
    /// Velocity of the torso's center in the world, meters per second.
    pub(super) velocity: Vector,
    /// Angular velocity of the torso about its own axes, radians per second.
    pub(super) angular_velocity: Vector,
    /// Rates of the angles, radians per second.
    pub(super) rates: [f32; JOINTS],
}

impl State {
    /// The start of an episode without noise: level, at rest, hips straight, feet lowered by one
    /// radian.
    pub(super) fn start() -> State {
        let mut angles = [0.0; JOINTS];
        for (leg, pair) in LEGS.iter().zip(angles.chunks_exact_mut(2)) {
            pair[1] = leg.ankle_side;
        }
        State {
            position: Vector::new(0.0, 0.0, START_HEIGHT),
            orientation: Rotation::IDENTITY,
            angles,
            velocity: Vector::ZERO,
            angular_velocity: Vector::ZERO,
            rates: [0.0; JOINTS],
        }
    }
}
