//! The ant in the physics: one multibody of nine links and eight hinges on an unbounded floor.
//!
//! In MuJoCo's model every hinge has an armature of 1, more than thirty times the inertia of what the hinge moves. In
//! rapier only multibodies have an armature, hence no impulse joints here. The softness of contacts and of joint
//! limits is chosen so that the ant moves under random torques as it does in MuJoCo.

use super::anatomy::{
    DENSITY, HIP_LIMIT, JOINTS, LEGS, LIMB_RADIUS, LINK_NAMES, LINKS, LONG_REACH, Leg, SHORT_REACH,
    State, TORSO_RADIUS, TORSO_ROW, limb_rows,
};
use crate::physics::{Dynamics, Physics, place_links};
use rapier3d::prelude::{
    ColliderBuilder, ColliderHandle, FrictionModel, Group, InteractionGroups, InteractionTestMode,
    Multibody, MultibodyJointHandle, MultibodyJointSet, PhysicsWorld, Pose, RevoluteJointBuilder,
    RigidBodyBuilder, RigidBodyHandle, SharedShape, SpringCoefficients, Vector,
};

/// Rotor inertia that every hinge adds to the inertia of what it turns, kilogram square meters.
const ARMATURE: f32 = 1.0;
/// Damping of every hinge, newton meter seconds per radian.
const DAMPING: f32 = 1.0;
/// Friction coefficient of the ant on the floor.
const FRICTION: f32 = 1.0;
/// Softness of the limits of the hinges.
const LIMIT_SOFTNESS: SpringCoefficients<f32> =
    SpringCoefficients { natural_frequency: 6.0, damping_ratio: 1.0 };
/// Degrees of freedom of the torso, which come first among the generalized velocities.
const TORSO_FREEDOMS: usize = 6;
/// Degrees of freedom of the whole ant.
const FREEDOMS: usize = TORSO_FREEDOMS + JOINTS;
/// Index of a hinge's angle among the coordinates of its joint.
const HINGE_COORDINATE: usize = 3;

const DYNAMICS: Dynamics = Dynamics {
    timestep_s: 0.02,
    solver_iterations: 1,
    // A foot can fall this far in one timestep; with less it would be deep in the floor at the first contact.
    contact_prediction_m: 0.1,
    contact_softness: SpringCoefficients { natural_frequency: 20.0, damping_ratio: 1.0 },
    friction_model: FrictionModel::Coulomb,
};

/// The handles of the ant and its floor.
#[derive(Clone, Copy, Debug)]
pub(super) struct Body {
    /// The torso, then leg and foot of every leg.
    pub(super) links: [RigidBodyHandle; LINKS],
    pub(super) floor: ColliderHandle,
    /// One of the hinges; it gives access to the multibody.
    hinge: MultibodyJointHandle,
}

/// Builds a world with the ant in it. Call [`Body::place`] before using the ant.
pub(super) fn build() -> (Physics, Body) {
    Physics::build(DYNAMICS, &LINK_NAMES, insert, |world, body| {
        let multibody = body.multibody_mut(&mut world.multibody_joints);
        assert_eq!(multibody.ndofs(), FREEDOMS, "a free torso and eight hinges");
        multibody.armature_mut().rows_mut(TORSO_FREEDOMS, JOINTS).fill(ARMATURE);
        // Rapier applies a little damping to every rotation by default, also to that of the free torso.
        multibody.damping_mut().fill(0.0);
        multibody.damping_mut().rows_mut(TORSO_FREEDOMS, JOINTS).fill(DAMPING);
    })
}

fn insert(world: &mut PhysicsWorld) -> Body {
    let floor = ColliderBuilder::new(SharedShape::halfspace(Vector::Z))
        .friction(FRICTION)
        .collision_groups(groups(Group::GROUP_1, Group::GROUP_2));
    let floor = world.insert_collider(floor, None);

    let torso = insert_link(world, ColliderBuilder::ball(TORSO_RADIUS), TORSO_ROW);
    let mut links = [torso; LINKS];
    let mut last_hinge = None;
    for (index, leg) in LEGS.iter().enumerate() {
        let [hip_row, leg_row, foot_row] = limb_rows(index);
        let hip = part(capsule(leg, SHORT_REACH), hip_row);
        world.insert_collider(hip, Some(torso));
        let upper = insert_link(world, capsule(leg, SHORT_REACH), leg_row);
        let foot = insert_link(world, capsule(leg, LONG_REACH), foot_row);

        let knee = leg.end(SHORT_REACH);
        let hip_joint = hinge(Vector::Z, knee, [-HIP_LIMIT, HIP_LIMIT]);
        let ankle_joint = hinge(leg.ankle_axis(), knee, leg.ankle_limits());
        world.insert_multibody_joint(torso, upper, hip_joint);
        last_hinge = world.insert_multibody_joint(upper, foot, ankle_joint);
        links[1 + 2 * index] = upper;
        links[2 + 2 * index] = foot;
    }
    Body { links, floor, hinge: last_hinge.expect("no link has two parents") }
}

/// Inserts a body with one collider.
fn insert_link(world: &mut PhysicsWorld, shape: ColliderBuilder, row: usize) -> RigidBodyHandle {
    world.insert(RigidBodyBuilder::dynamic().can_sleep(false), part(shape, row)).0
}

/// Makes a collider that touches only the floor and has its row in the contact forces as user data.
fn part(shape: ColliderBuilder, row: usize) -> ColliderBuilder {
    shape
        .density(DENSITY)
        .friction(FRICTION)
        .collision_groups(groups(Group::GROUP_2, Group::GROUP_1))
        .user_data(row as u128)
}

fn capsule(leg: &Leg, reach: f32) -> ColliderBuilder {
    ColliderBuilder::capsule_from_endpoints(Vector::ZERO, leg.end(reach), LIMB_RADIUS)
}

/// Makes a hinge at a point of the parent, where the child has its origin.
fn hinge(axis: Vector, point: Vector, limits: [f32; 2]) -> RevoluteJointBuilder {
    RevoluteJointBuilder::new(axis).local_anchor1(point).limits(limits).softness(LIMIT_SOFTNESS)
}

fn groups(memberships: Group, filter: Group) -> InteractionGroups {
    InteractionGroups::new(memberships, filter, InteractionTestMode::And)
}

impl Body {
    fn multibody<'set>(&self, joints: &'set MultibodyJointSet) -> &'set Multibody {
        joints.get(self.hinge).expect("no joint is ever removed").0
    }

    fn multibody_mut<'set>(&self, joints: &'set mut MultibodyJointSet) -> &'set mut Multibody {
        joints.get_mut(self.hinge).expect("no joint is ever removed").0
    }

    /// Puts the ant into a state.
    pub(super) fn place(&self, world: &mut PhysicsWorld, state: &State) {
        let pose = Pose::from_parts(state.position, state.orientation);
        world.bodies[self.links[0]].set_position(pose, false);

        let multibody = self.multibody_mut(&mut world.multibody_joints);
        let mut displacements = [0.0; FREEDOMS];
        for (joint, angle) in state.angles.iter().enumerate() {
            displacements[TORSO_FREEDOMS + joint] = angle - angle_of(multibody, joint);
        }
        multibody.apply_displacements(&displacements);
        let angular_velocity = state.orientation * state.angular_velocity;
        let mut velocities = multibody.generalized_velocity_mut();
        velocities.rows_mut(0, 3).copy_from_slice(&state.velocity.to_array());
        velocities.rows_mut(3, 3).copy_from_slice(&angular_velocity.to_array());
        velocities.rows_mut(TORSO_FREEDOMS, JOINTS).copy_from_slice(&state.rates);

        place_links(multibody, &mut world.bodies);
    }

    /// Reads the current state of the ant.
    pub(super) fn state(&self, world: &PhysicsWorld) -> State {
        let torso = &world.bodies[self.links[0]];
        let multibody = self.multibody(&world.multibody_joints);
        let velocities = multibody.generalized_velocity();
        let vector = |first: usize| {
            Vector::new(velocities[first], velocities[first + 1], velocities[first + 2])
        };
        let orientation = *torso.rotation();
        State {
            position: torso.translation(),
            orientation,
            angles: std::array::from_fn(|joint| angle_of(multibody, joint)),
            velocity: vector(0),
            angular_velocity: orientation.inverse() * vector(3),
            rates: std::array::from_fn(|joint| velocities[TORSO_FREEDOMS + joint]),
        }
    }

    /// Sets the torque about the axis of every hinge, newton meters.
    ///
    /// Opposite torques on the two links of a hinge act on its angle alone. They keep their directions in the world
    /// until the next call, so call this before every timestep.
    pub(super) fn drive(&self, world: &mut PhysicsWorld, torques: &[f32; JOINTS]) {
        let mut on_links = [Vector::ZERO; LINKS];
        let torso_rotation = *world.bodies[self.links[0]].rotation();
        for (index, leg) in LEGS.iter().enumerate() {
            let (upper, foot) = (1 + 2 * index, 2 + 2 * index);
            let upper_rotation = *world.bodies[self.links[upper]].rotation();
            let at_hip = torso_rotation * Vector::Z * torques[2 * index];
            let at_ankle = upper_rotation * leg.ankle_axis() * torques[2 * index + 1];
            on_links[0] -= at_hip;
            on_links[upper] += at_hip - at_ankle;
            on_links[foot] += at_ankle;
        }
        for (link, torque) in self.links.iter().zip(on_links) {
            let body = &mut world.bodies[*link];
            body.reset_torques(false);
            body.add_torque(torque, false);
        }
    }
}

/// Returns the angle of a hinge; its link follows the torso's in the order of insertion.
fn angle_of(multibody: &Multibody, joint: usize) -> f32 {
    multibody.link(1 + joint).expect("the torso and eight links").joint().coords()[HINGE_COORDINATE]
}

#[cfg(test)]
mod tests {
    use super::*;
    use rapier3d::prelude::Rotation;

    /// Number of timesteps for which an action is held.
    const STEP: usize = 5;

    /// Returns an ant at rest far above the floor.
    fn floating() -> (Physics, Body, State) {
        let (mut physics, body) = build();
        let mut state = State::start();
        state.position.z = 100.0;
        body.place(&mut physics.world, &state);
        (physics, body, state)
    }

    /// Applies a constant torque for some timesteps.
    fn turn(physics: &mut Physics, body: &Body, joint: usize, torque: f32, timesteps: usize) {
        let mut torques = [0.0; JOINTS];
        torques[joint] = torque;
        for _ in 0..timesteps {
            body.drive(&mut physics.world, &torques);
            physics.step();
        }
    }

    #[test]
    fn the_ant_weighs_what_the_authors_does() {
        let (physics, body) = build();
        let masses = body.links.map(|link| physics.world.bodies[link].mass());
        let total: f32 = masses.iter().sum();
        assert!((total - 0.911).abs() < 0.001, "{total} kg");
        assert!((masses[0] - 0.484).abs() < 0.001, "torso with hips: {} kg", masses[0]);
        assert!((masses[1] - 0.039).abs() < 0.001, "leg: {} kg", masses[1]);
        assert!((masses[2] - 0.068).abs() < 0.001, "foot: {} kg", masses[2]);
    }

    #[test]
    fn a_placed_ant_is_where_it_was_placed() {
        let (mut physics, body) = build();
        let mut state = State::start();
        state.position = Vector::new(0.3, -0.2, 2.0);
        state.orientation = Rotation::from_xyzw(0.1, -0.2, 0.3, 0.9).normalize();
        state.velocity = Vector::new(0.5, 0.6, -0.7);
        state.angular_velocity = Vector::new(-1.0, 2.0, 3.0);
        for (joint, (angle, rate)) in state.angles.iter_mut().zip(&mut state.rates).enumerate() {
            *angle += 0.01 * joint as f32;
            *rate = 0.1 * joint as f32 - 0.4;
        }
        // Twice: from the state in which the world was built, and from another state.
        for steps in [0, 3] {
            turn(&mut physics, &body, 2, 100.0, steps);
            body.place(&mut physics.world, &state);
            let found = body.state(&physics.world);
            let close = |one: &[f32], other: &[f32]| {
                one.iter().zip(other).all(|(one, other)| (one - other).abs() < 1e-5)
            };
            assert_eq!((found.position, found.orientation), (state.position, state.orientation));
            assert_eq!((found.velocity, found.rates), (state.velocity, state.rates));
            assert!(close(&found.angles, &state.angles), "{found:?}");
            let angular = [found.angular_velocity, state.angular_velocity].map(|it| it.to_array());
            assert!(close(&angular[0], &angular[1]), "{found:?}");
        }
    }

    #[test]
    fn a_foot_is_where_its_angles_put_it() {
        let (mut physics, body, mut state) = floating();
        state.angles[0] = 0.5;
        body.place(&mut physics.world, &state);
        // Leg 1 turned by half a radian about z, its foot lowered by one.
        let turned = Vector::new(0.2, 0.2, 100.0)
            + Rotation::from_rotation_z(0.5) * Vector::new(0.2, 0.2, 0.0);
        let foot = physics.world.bodies[body.links[2]].translation();
        assert!(foot.distance(turned) < 1e-4, "{foot} instead of {turned}");
        let low = physics.world.bodies[body.links[2]].center_of_mass().z;
        let expected = 100.0 - 0.08_f32.sqrt() * libm::sinf(1.0);
        assert!((low - expected).abs() < 1e-3, "{low} instead of {expected}");
    }

    /// A hinge in free flight obeys `I dw/dt = torque - w`, where the inertia `I` lies between the armature and the
    /// armature plus the inertia of the limb about its hinge.
    #[test]
    fn a_torque_turns_a_hinge_against_armature_and_damping() {
        for (joint, limb_inertia) in [(0, 0.03), (1, 0.008), (6, 0.03), (7, 0.008)] {
            let (mut physics, body, start) = floating();
            turn(&mut physics, &body, joint, 3.0, STEP);
            let state = body.state(&physics.world);
            let rate = |inertia: f32| 3.0 * (1.0 - libm::expf(-0.1 / inertia));
            // One percent for the damping, which acts on the rate at the end of a timestep of 20 ms.
            let range = rate(1.0 + limb_inertia) * 0.99..rate(1.0);
            assert!(
                range.contains(&state.rates[joint]),
                "{joint}: {} of {range:?}",
                state.rates[joint]
            );
            let turned = state.angles[joint] - start.angles[joint];
            // A timestep turns the hinge at the rate of its end: half a timestep more than the integral.
            let expected = 0.0145 + DYNAMICS.timestep_s / 2.0 * state.rates[joint];
            assert!((turned - expected).abs() < 0.0005, "{joint}: {turned} instead of {expected}");
            for (other, rate) in state.rates.iter().enumerate().filter(|(other, _)| *other != joint)
            {
                assert!(rate.abs() < 0.03, "{joint} turns {other} at {rate}");
            }
        }
    }

    #[test]
    fn limits_give_way_to_full_torque_and_return() {
        for (joint, limits) in [(0, [-HIP_LIMIT, HIP_LIMIT]), (3, LEGS[1].ankle_limits())] {
            for (torque, sign) in [(150.0, 1.0), (-150.0, -1.0)] {
                let (mut physics, body, _) = floating();
                let beyond = |physics: &Physics| {
                    let angle = body.state(&physics.world).angles[joint];
                    if sign > 0.0 { angle - limits[1] } else { limits[0] - angle }
                };
                turn(&mut physics, &body, joint, torque, 2 * STEP);
                let pressed = beyond(&physics);
                assert!((0.15..0.28).contains(&pressed), "{joint}: {pressed} rad beyond");
                turn(&mut physics, &body, joint, 0.0, 20 * STEP);
                assert!(beyond(&physics) < 0.01, "{joint}: {} rad beyond", beyond(&physics));
            }
        }
    }

    #[test]
    fn a_free_ant_keeps_its_spin() {
        let (mut physics, body, mut state) = floating();
        state.angular_velocity = Vector::new(0.0, 0.0, 1.0);
        body.place(&mut physics.world, &state);
        turn(&mut physics, &body, 0, 0.0, 10 * STEP);
        let spin = body.state(&physics.world).angular_velocity.z;
        assert!((spin - 1.0).abs() < 0.05, "{spin} rad/s");
    }
}
