//! The gripper, the cube and the table in the physics.
//!
//! The robot's arm is a gantry: a palm that slides along three axes and never turns, with two fingers that slide along
//! y. In the authors' simulator a weld that fixes the orientation drags the robot, so its arm only limits its reach.
//! The gantry is one multibody driven by implicit springs, which follow the same law as MuJoCo's position actuators.
//! The palm's body has its origin at the grip site, between the fingertips.

use crate::EnvironmentError;
use crate::physics::{Dynamics, Physics, place_links};
use crate::scene::{Pose, Shape, Solid};
use rapier3d::prelude::{
    ColliderBuilder, FrictionModel, GenericJointBuilder, JointAxesMask, MultibodyJoint,
    MultibodyJointHandle, PhysicsWorld, PrismaticJointBuilder, RigidBodyBuilder, RigidBodyHandle,
    Rotation, SharedShape, SpringCoefficients, Vector,
};
use xxhash_rust::xxh3::Xxh3;

/// Number of timesteps for which an action acts: 0.04 s.
const TIMESTEPS: usize = 2;
const DYNAMICS: Dynamics = Dynamics {
    timestep_s: 0.02,
    solver_iterations: 4,
    contact_prediction_m: 0.02,
    contact_softness: SpringCoefficients { natural_frequency: 60.0, damping_ratio: 10.0 },
    friction_model: FrictionModel::Simplified,
};
const BODY_NAMES: [&str; 6] = ["table", "cube", "gantry", "palm", "right finger", "left finger"];
const FRICTION: f32 = 1.0;

const TABLE_CENTER: Vector = Vector::new(1.3, 0.75, 0.2);
const TABLE_HALF_EXTENTS: [f32; 3] = [0.25, 0.35, 0.2];
const CUBE_HALF_EXTENT: f32 = 0.025;
const CUBE_MASS: f32 = 2.0;
/// Height of the center of a cube at rest, which sinks slightly into the table.
const CUBE_REST_HEIGHT: f32 = 0.424_93;

const PALM_HALF_EXTENTS: [f32; 3] = [0.04, 0.063, 0.061];
/// Center of the palm's box relative to the grip site.
const PALM_CENTER: Vector = Vector::new(0.0, 0.0, 0.113);
const PALM_MASS: f32 = 1.5;
// With these values the palm follows an action as in MuJoCo, to a millimeter: see docs/fidelity.md.
const PALM_DAMPING: f32 = 1240.0;
const PALM_STIFFNESS: f32 = 31_000.0;
/// The box within which the targets of the grip site lie.
const REACH_MIN: [f32; 3] = [1.0, 0.35, 0.40];
const REACH_MAX: [f32; 3] = [1.6, 1.15, 0.95];

const FINGER_HALF_EXTENTS: [f32; 3] = [0.0135, 0.007, 0.0385];
/// Offset from the grip site to the center of a closed finger: sideways, and up.
const FINGER_SIDE: f32 = 0.0079;
const FINGER_UP: f32 = 0.02;
const FINGER_LIMITS: [f32; 2] = [0.0, 0.05];
/// Largest target of a finger's actuator, beyond the joint's limit.
const FINGER_TARGET_MAX: f32 = 0.2;
const FINGER_MASS: f32 = 4.0;
const FINGER_ARMATURE: f32 = 100.0;
const FINGER_DAMPING: f32 = 1000.0;
const FINGER_STIFFNESS: f32 = 30_000.0;

/// Radius of the ball that marks the goal, within which the cube succeeds.
pub(super) const GOAL_RADIUS: f32 = 0.05;

/// The solids that a viewer draws; the palm is drawn at its box.
pub(super) static SOLIDS: [Solid; 6] = [
    cuboid("table", TABLE_HALF_EXTENTS, [0.78, 0.76, 0.72, 1.0]),
    cuboid("cube", [CUBE_HALF_EXTENT; 3], [0.16, 0.32, 0.56, 1.0]),
    cuboid("palm", PALM_HALF_EXTENTS, [0.45, 0.46, 0.48, 1.0]),
    cuboid("right finger", FINGER_HALF_EXTENTS, [0.25, 0.26, 0.28, 1.0]),
    cuboid("left finger", FINGER_HALF_EXTENTS, [0.25, 0.26, 0.28, 1.0]),
    Solid {
        name: "goal",
        shape: Shape::Ball { radius: GOAL_RADIUS },
        color: [0.85, 0.2, 0.15, 0.4],
    },
];

const fn cuboid(name: &'static str, half_extents: [f32; 3], color: [f32; 4]) -> Solid {
    Solid { name, shape: Shape::Cuboid { half_extents }, color }
}

/// The physics of a Fetch task.
pub(super) struct Scene {
    physics: Physics,
    handles: Handles,
}

struct Handles {
    cube: RigidBodyHandle,
    palm: RigidBodyHandle,
    /// The right finger, at larger y, and the left finger.
    fingers: [RigidBodyHandle; 2],
    palm_joint: MultibodyJointHandle,
    finger_joints: [MultibodyJointHandle; 2],
}

impl Scene {
    /// Builds the scene with the grip site at `grip_start` and the fingers closed.
    pub(super) fn new(grip_start: Vector) -> Scene {
        let (physics, handles) = Physics::build(DYNAMICS, &BODY_NAMES, insert, |world, handles| {
            adjust(world, handles, grip_start);
        });
        Scene { physics, handles }
    }

    /// Restores the start, with the cube on the table at `x`, `y`.
    pub(super) fn reset(&mut self, [x, y]: [f32; 2]) {
        self.physics.restore();
        let cube = &mut self.physics.world.bodies[self.handles.cube];
        cube.set_translation(Vector::new(x, y, CUBE_REST_HEIGHT), false);
    }

    /// Sets the palm's target `displacement` meters from its position.
    pub(super) fn pull_palm(&mut self, displacement: [f32; 3]) {
        let joint = joint_mut(&mut self.physics.world, self.handles.palm_joint);
        let position = joint.coords();
        for axis in 0..3 {
            let target = position[axis] + displacement[axis];
            let target = target.clamp(REACH_MIN[axis], REACH_MAX[axis]);
            joint.set_spring(axis, PALM_STIFFNESS, target);
        }
    }

    /// Sets each finger's target `displacement` meters farther out than its position.
    pub(super) fn pull_fingers(&mut self, displacement: f32) {
        for handle in self.handles.finger_joints {
            let joint = joint_mut(&mut self.physics.world, handle);
            let target = (joint.coords()[0] + displacement).clamp(0.0, FINGER_TARGET_MAX);
            joint.set_spring(0, FINGER_STIFFNESS, target);
        }
    }

    /// Simulates one step of the environment.
    pub(super) fn simulate(&mut self) {
        for _ in 0..TIMESTEPS {
            self.physics.step();
        }
    }

    /// Returns the position of the grip site.
    pub(super) fn grip(&self) -> Vector {
        self.physics.world.bodies[self.handles.palm].translation()
    }

    /// Returns the position of the cube.
    pub(super) fn cube(&self) -> Vector {
        self.physics.world.bodies[self.handles.cube].translation()
    }

    /// Returns the orientation of the cube.
    pub(super) fn cube_orientation(&self) -> Rotation {
        *self.physics.world.bodies[self.handles.cube].rotation()
    }

    /// Returns the openings of the right and the left finger.
    pub(super) fn fingers(&self) -> [f32; 2] {
        self.handles.finger_joints.map(|handle| {
            let joints = &self.physics.world.multibody_joints;
            let (multibody, link) = joints.get(handle).expect(KEPT);
            multibody.link(link).expect(KEPT).joint().coords()[0]
        })
    }

    /// Refuses a state that is not finite.
    pub(super) fn check_finite(&self, step: u32) -> Result<(), EnvironmentError> {
        self.physics.check_finite(step)
    }

    pub(super) fn hash(&self, hasher: &mut Xxh3) {
        self.physics.hash(hasher);
    }

    /// Appends the poses of [`SOLIDS`].
    pub(super) fn append_poses(&self, goal: Vector, poses: &mut Vec<Pose>) {
        let Handles { cube, palm, fingers: [right, left], .. } = self.handles;
        let upright = |position: Vector| Pose {
            position: position.to_array(),
            orientation: Rotation::IDENTITY.to_array(),
        };
        let finger =
            |handle: RigidBodyHandle| upright(self.physics.world.bodies[handle].translation());
        let palm = self.physics.world.bodies[palm].translation() + PALM_CENTER;
        let cube = &self.physics.world.bodies[cube];
        poses.extend([
            upright(TABLE_CENTER),
            Pose {
                position: cube.translation().to_array(),
                orientation: cube.rotation().to_array(),
            },
            upright(palm),
            finger(right),
            finger(left),
            upright(goal),
        ]);
    }
}

/// Panic message: why a handle is always valid.
const KEPT: &str = "a joint is never removed";

fn joint_mut(world: &mut PhysicsWorld, handle: MultibodyJointHandle) -> &mut MultibodyJoint {
    let (multibody, link) = world.multibody_joints.get_mut(handle).expect(KEPT);
    &mut multibody.link_mut(link).expect(KEPT).joint
}

fn insert(world: &mut PhysicsWorld) -> Handles {
    let table = world.insert_body(RigidBodyBuilder::fixed());
    let [x, y, z] = TABLE_HALF_EXTENTS;
    let top = ColliderBuilder::cuboid(x, y, z).translation(TABLE_CENTER).friction(FRICTION);
    world.insert_collider(top, Some(table));
    // The floor keeps what falls from the table within a range that networks can read.
    let floor = ColliderBuilder::new(SharedShape::halfspace(Vector::Z)).friction(FRICTION);
    world.insert_collider(floor, Some(table));

    let cube = RigidBodyBuilder::dynamic().can_sleep(false);
    let (cube, _) = world.insert(cube, collider([CUBE_HALF_EXTENT; 3], CUBE_MASS));

    let gantry = world.insert_body(RigidBodyBuilder::fixed());
    let weightless = || RigidBodyBuilder::dynamic().gravity_scale(0.0).can_sleep(false);
    let palm = collider(PALM_HALF_EXTENTS, PALM_MASS).translation(PALM_CENTER);
    let (palm, _) = world.insert(weightless(), palm);
    let slides = GenericJointBuilder::new(JointAxesMask::ANG_AXES).build();
    let palm_joint = world.insert_multibody_joint(gantry, palm, slides).expect(TREE);

    let [right, left] = [1.0, -1.0].map(|side: f32| {
        let (finger, _) = world.insert(weightless(), collider(FINGER_HALF_EXTENTS, FINGER_MASS));
        let slide = PrismaticJointBuilder::new(Vector::new(0.0, side, 0.0))
            .local_anchor1(Vector::new(0.0, side * FINGER_SIDE, FINGER_UP))
            .limits(FINGER_LIMITS);
        (finger, world.insert_multibody_joint(palm, finger, slide).expect(TREE))
    });
    Handles { cube, palm, fingers: [right.0, left.0], palm_joint, finger_joints: [right.1, left.1] }
}

/// Panic message: why a joint can always be inserted.
const TREE: &str = "no link has two parents";

fn collider([x, y, z]: [f32; 3], mass: f32) -> ColliderBuilder {
    ColliderBuilder::cuboid(x, y, z).mass(mass).friction(FRICTION)
}

/// Gives the joints their springs and moves the gripper to its start.
fn adjust(world: &mut PhysicsWorld, handles: &Handles, grip_start: Vector) {
    let (multibody, _) = world.multibody_joints.get_mut(handles.palm_joint).expect(KEPT);
    assert_eq!(multibody.ndofs(), 5, "three of the palm, one of each finger");
    multibody.set_self_contacts_enabled(false);
    multibody.armature_mut().rows_mut(3, 2).fill(FINGER_ARMATURE);
    multibody.damping_mut().rows_mut(0, 3).fill(PALM_DAMPING);
    multibody.damping_mut().rows_mut(3, 2).fill(FINGER_DAMPING);
    let [x, y, z] = grip_start.to_array();
    multibody.apply_displacements(&[x, y, z, 0.0, 0.0]);
    place_links(multibody, &mut world.bodies);
    for axis in 0..3 {
        let joint = joint_mut(world, handles.palm_joint);
        joint.set_spring(axis, PALM_STIFFNESS, grip_start[axis]);
    }
    for handle in handles.finger_joints {
        joint_mut(world, handle).set_spring(0, FINGER_STIFFNESS, 0.0);
    }
}
