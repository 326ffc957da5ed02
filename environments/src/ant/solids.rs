//! What a viewer draws of Ant Reach: a patch of the floor, the parts of the ant and the goal.

use super::anatomy::{
    LEGS, LIMB_RADIUS, LINK_NAMES, LONG_REACH, SHORT_REACH, START_HEIGHT, TORSO_RADIUS,
};
use super::body::Body;
use super::observation::Goal;
use crate::{Pose, Shape, Solid};
use rapier3d::prelude::{self as rapier, PhysicsWorld, Rotation, Vector};
use std::f32::consts::SQRT_2;

const FLOOR_COLOR: [f32; 4] = [0.8, 0.9, 0.8, 1.0];
const TORSO_COLOR: [f32; 4] = [0.8, 0.6, 0.4, 1.0];
const LIMB_COLOR: [f32; 4] = [0.7, 0.5, 0.3, 1.0];
const GOAL_COLOR: [f32; 4] = [0.2, 0.8, 0.3, 0.4];
/// Half of the thickness of the floor patch, meters.
const FLOOR_HALF_HEIGHT: f32 = 0.05;

/// The floor, the torso, hip, leg and foot of each leg, and the goal.
pub(super) static SOLIDS: [Solid; 15] = [
    Solid {
        name: "floor",
        shape: Shape::Cuboid { half_extents: [8.0, 8.0, FLOOR_HALF_HEIGHT] },
        color: FLOOR_COLOR,
    },
    Solid { name: LINK_NAMES[0], shape: Shape::Ball { radius: TORSO_RADIUS }, color: TORSO_COLOR },
    limb("hip 1", SHORT_REACH),
    limb(LINK_NAMES[1], SHORT_REACH),
    limb(LINK_NAMES[2], LONG_REACH),
    limb("hip 2", SHORT_REACH),
    limb(LINK_NAMES[3], SHORT_REACH),
    limb(LINK_NAMES[4], LONG_REACH),
    limb("hip 3", SHORT_REACH),
    limb(LINK_NAMES[5], SHORT_REACH),
    limb(LINK_NAMES[6], LONG_REACH),
    limb("hip 4", SHORT_REACH),
    limb(LINK_NAMES[7], SHORT_REACH),
    limb(LINK_NAMES[8], LONG_REACH),
    Solid {
        name: "goal",
        shape: Shape::Ball { radius: super::SUCCESS_DISTANCE },
        color: GOAL_COLOR,
    },
];

const fn limb(name: &'static str, reach: f32) -> Solid {
    let shape = Shape::Capsule { radius: LIMB_RADIUS, half_length: reach * SQRT_2 / 2.0 };
    Solid { name, shape, color: LIMB_COLOR }
}

/// Appends the poses of [`SOLIDS`].
pub(super) fn append_poses(world: &PhysicsWorld, body: &Body, goal: &Goal, poses: &mut Vec<Pose>) {
    let link = |index: usize| *world.bodies[body.links[index]].position();
    let torso = link(0);
    let standing = |position| rapier::Pose::from_parts(position, Rotation::IDENTITY);
    poses.push(pose(standing(Vector::new(0.0, 0.0, -FLOOR_HALF_HEIGHT))));
    poses.push(pose(torso));
    for (index, leg) in LEGS.iter().enumerate() {
        let along = |reach: f32| {
            let end = leg.end(reach);
            let turn = Rotation::from_rotation_arc(Vector::Z, end.normalize());
            rapier::Pose::from_parts(end * 0.5, turn)
        };
        poses.push(pose(torso * along(SHORT_REACH)));
        poses.push(pose(link(1 + 2 * index) * along(SHORT_REACH)));
        poses.push(pose(link(2 + 2 * index) * along(LONG_REACH)));
    }
    let Vector { x, y, .. } = goal.position;
    poses.push(pose(standing(Vector::new(x, y, START_HEIGHT))));
}

fn pose(pose: rapier::Pose) -> Pose {
    Pose { position: pose.translation.to_array(), orientation: pose.rotation.to_array() }
}
