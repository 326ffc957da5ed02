//! The parts of the ant: a ball with four legs of three capsules each, after the authors' MuJoCo model.
//!
//! | part | count | shape, meters | mass, kg | moved by |
//! |---|---|---|---|---|
//! | torso | 1 | ball, radius 0.25 | 0.327 | nothing, it is free |
//! | hip | 4 | capsule, radius 0.08, from the torso's center by (0.2, 0.2) | 0.039 | nothing, it is part of the torso |
//! | leg | 4 | capsule, radius 0.08, onward by (0.2, 0.2) | 0.039 | its hip joint, about z |
//! | foot | 4 | capsule, radius 0.08, onward by (0.4, 0.4) | 0.068 | its ankle joint, about a diagonal |
//!
//! All displacements are those of the front left leg; [`Leg::toward`] has the signs for the other corners.

use rapier3d::prelude::{Rotation, Vector};

/// Row of the torso in the contact forces.
pub(super) const TORSO_ROW: usize = 1;

/// Returns the rows of a leg's hip, leg and foot in the contact forces.
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
/// Reach of a hip or a leg along x and along y, meters.
pub(super) const SHORT_REACH: f32 = 0.2;
/// Reach of a foot along x and along y, meters.
pub(super) const LONG_REACH: f32 = 0.4;
/// Largest angle of a hip joint in either direction, radians.
pub(super) const HIP_LIMIT: f32 = 30_f32.to_radians();
/// Range of an ankle joint in the direction that lowers its foot, radians.
pub(super) const ANKLE_LIMITS: [f32; 2] = [30_f32.to_radians(), 70_f32.to_radians()];
/// Height of the torso's center at the start of an episode, meters.
pub(super) const START_HEIGHT: f32 = 0.55;

/// The names of the bodies, in the order of the links.
pub(super) const LINK_NAMES: [&str; LINKS] =
    ["torso", "leg 1", "foot 1", "leg 2", "foot 2", "leg 3", "foot 3", "leg 4", "foot 4"];

/// One leg.
pub(super) struct Leg {
    /// The signs of x and y in the direction that the leg points, away from the torso.
    pub(super) toward: [f32; 2],
    /// The signs of x and y of the ankle's axis.
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
    /// Returns the end of a capsule with this reach, relative to its start.
    pub(super) fn end(&self, reach: f32) -> Vector {
        Vector::new(self.toward[0] * reach, self.toward[1] * reach, 0.0)
    }

    /// Returns the unit axis of the ankle, which is the same in the frames of the leg and of the foot.
    pub(super) fn ankle_axis(&self) -> Vector {
        Vector::new(self.ankle_axis[0], self.ankle_axis[1], 0.0).normalize()
    }

    /// Returns the lowest and the highest angle of the ankle, radians.
    pub(super) fn ankle_limits(&self) -> [f32; 2] {
        let [small, large] = ANKLE_LIMITS;
        if self.ankle_side > 0.0 { [small, large] } else { [-large, -small] }
    }
}

/// The ant's pose and velocity, in the coordinates of the authors' simulator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct State {
    /// Center of the torso in the world, meters.
    pub(super) position: Vector,
    /// Rotation from the torso's axes to the world's.
    pub(super) orientation: Rotation,
    /// Angles of hip 1, ankle 1, hip 2 and so on to ankle 4, radians.
    pub(super) angles: [f32; JOINTS],
    /// Velocity of the torso's center in the world, meters per second.
    pub(super) velocity: Vector,
    /// Angular velocity of the torso about its own axes, radians per second.
    pub(super) angular_velocity: Vector,
    /// Angular velocities of the joints, radians per second.
    pub(super) rates: [f32; JOINTS],
}

impl State {
    /// Returns the start of an episode without noise: level, at rest, hips straight, feet lowered by one radian.
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
