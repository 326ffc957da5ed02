//! The rigid-body world of the Fetch tasks and Ant Reach: built once, stepped, and restored bit for bit at every
//! reset.
//!
//! Rapier keeps more than poses and velocities from step to step: contacts carry their impulses over, and the tree of
//! the broad phase depends on its history. Putting bodies back in place therefore does not repeat an episode.
//! [`Physics::restore`] restores everything from a copy made before the first step, so that an episode depends only on
//! its start and its actions.

use crate::EnvironmentError;
use rapier3d::prelude::{
    BroadPhaseBvh, BvhOptimizationStrategy, ColliderSet, FrictionModel, ImpulseJointSet,
    IslandManager, Multibody, MultibodyJointSet, NarrowPhase, PhysicsWorld, RigidBody,
    RigidBodyHandle, RigidBodySet, SoftBodySet, SpringCoefficients, Vector,
};
use xxhash_rust::xxh3::Xxh3;

/// Gravitational acceleration along z, meters per second squared.
const GRAVITY_Z: f32 = -9.81;

/// How the world of a task is simulated.
#[derive(Clone, Copy)]
pub(crate) struct Dynamics {
    /// Time that one call of [`Physics::step`] simulates, seconds.
    pub(crate) timestep_s: f32,
    /// Solver iterations of a timestep: rapier divides it into this many substeps.
    pub(crate) solver_iterations: usize,
    /// Largest gap between two shapes at which the solver already generates a contact, meters.
    pub(crate) contact_prediction_m: f32,
    /// Softness of contacts, including those with fixed bodies.
    pub(crate) contact_softness: SpringCoefficients<f32>,
    /// Friction model of bodies outside multibodies; multibodies always use Coulomb friction.
    pub(crate) friction_model: FrictionModel,
}

/// A world, and the copy from which every episode begins.
pub(crate) struct Physics {
    /// The world; the task reads and drives it between steps.
    pub(crate) world: PhysicsWorld,
    pristine: Pristine,
    /// Names of all bodies, in the order of insertion.
    body_names: &'static [&'static str],
}

/// The state of a world that a step changes and the next step reads.
struct Pristine {
    islands: IslandManager,
    broad_phase: BroadPhaseBvh,
    narrow_phase: NarrowPhase,
    bodies: RigidBodySet,
    colliders: ColliderSet,
    impulse_joints: ImpulseJointSet,
    multibody_joints: MultibodyJointSet,
    soft_bodies: SoftBodySet,
}

impl Physics {
    /// Builds a world in two stages and returns it with the result of `insert`.
    ///
    /// `insert` adds bodies, colliders and joints. `adjust` runs after it, when the degrees of freedom of every
    /// multibody are known; armature, damping and springs belong there. `body_names` has the name of every body in the
    /// order of insertion.
    pub(crate) fn build<Handles>(
        dynamics: Dynamics,
        body_names: &'static [&'static str],
        insert: impl FnOnce(&mut PhysicsWorld) -> Handles,
        adjust: impl FnOnce(&mut PhysicsWorld, &Handles),
    ) -> (Physics, Handles) {
        let mut world = empty_world();
        // Optimization gains nothing for so few leaves, which every reset restores.
        world.broad_phase =
            BroadPhaseBvh::with_optimization_strategy(BvhOptimizationStrategy::None);
        let handles = insert(&mut world);
        assert_eq!(world.bodies.len(), body_names.len(), "every body has a name");
        // A step of zero duration: it counts the degrees of freedom and moves nothing.
        world.integration_parameters.dt = 0.0;
        world.step();
        adjust(&mut world, &handles);

        let parameters = &mut world.integration_parameters;
        parameters.dt = dynamics.timestep_s;
        parameters.num_solver_iterations = dynamics.solver_iterations;
        parameters.normalized_prediction_distance = dynamics.contact_prediction_m;
        parameters.contact_softness = dynamics.contact_softness;
        parameters.static_contact_softness = dynamics.contact_softness;
        parameters.friction_model = dynamics.friction_model;
        let pristine = Pristine::copy(&world);
        (Physics { world, pristine, body_names }, handles)
    }

    /// Restores the world to the state in which it was built.
    pub(crate) fn restore(&mut self) {
        let Pristine {
            islands,
            broad_phase,
            narrow_phase,
            bodies,
            colliders,
            impulse_joints,
            multibody_joints,
            soft_bodies,
        } = &self.pristine;
        self.world.islands.clone_from(islands);
        self.world.broad_phase.clone_from(broad_phase);
        self.world.narrow_phase.clone_from(narrow_phase);
        self.world.bodies.clone_from(bodies);
        self.world.colliders.clone_from(colliders);
        self.world.impulse_joints.clone_from(impulse_joints);
        self.world.multibody_joints.clone_from(multibody_joints);
        self.world.soft_bodies.clone_from(soft_bodies);
    }

    /// Simulates one timestep.
    pub(crate) fn step(&mut self) {
        self.world.step();
    }

    /// Hashes the exact pose and velocity of every body and the coordinates and velocities of every multibody joint.
    /// State that contacts carry over is left out, because it follows from the same history.
    pub(crate) fn hash(&self, hasher: &mut Xxh3) {
        let mut feed = |number: f32| hasher.update(&number.to_le_bytes());
        for (_, body) in self.world.bodies.iter() {
            numbers(body).into_iter().for_each(&mut feed);
        }
        for multibody in self.world.multibody_joints.multibodies() {
            multibody.generalized_velocity().iter().copied().for_each(&mut feed);
            for link in multibody.links() {
                link.joint().coords().iter().copied().for_each(&mut feed);
                link.joint().joint_rot().to_array().into_iter().for_each(&mut feed);
            }
        }
    }

    /// Checks that the state of every body and joint is finite; call it before using a state.
    ///
    /// # Errors
    /// Names the first body whose own state, or whose joint's, is not finite.
    pub(crate) fn check_finite(&self, step: u32) -> Result<(), EnvironmentError> {
        let refused = |handle: RigidBodyHandle, found| {
            let part = self.body_names[handle.into_raw_parts().0 as usize];
            Err(EnvironmentError::StateNotFinite { part, found, step })
        };
        for (handle, body) in self.world.bodies.iter() {
            // Rapier moves a body with a non-finite state back to its last finite pose and disables it.
            if !body.is_enabled() {
                return refused(handle, f32::NAN);
            }
            if let Some(found) = numbers(body).into_iter().find(|number| !number.is_finite()) {
                return refused(handle, found);
            }
        }
        for multibody in self.world.multibody_joints.multibodies() {
            for link in multibody.links() {
                let velocities = multibody.joint_velocity(link);
                if let Some(found) = velocities.iter().find(|number| !number.is_finite()) {
                    return refused(link.rigid_body_handle(), *found);
                }
            }
        }
        Ok(())
    }
}

impl Pristine {
    fn copy(world: &PhysicsWorld) -> Pristine {
        Pristine {
            islands: world.islands.clone(),
            broad_phase: world.broad_phase.clone(),
            narrow_phase: world.narrow_phase.clone(),
            bodies: world.bodies.clone(),
            colliders: world.colliders.clone(),
            impulse_joints: world.impulse_joints.clone(),
            multibody_joints: world.multibody_joints.clone(),
            soft_bodies: world.soft_bodies.clone(),
        }
    }
}

fn empty_world() -> PhysicsWorld {
    let mut world = PhysicsWorld::new();
    world.gravity = Vector::new(0.0, 0.0, GRAVITY_Z);
    // With contact recycling, contacts of slowly moving bodies are kept, and the gripper loses one cube in fifteen.
    world.integration_parameters.contact_recycling = false;
    world.integration_parameters.max_ccd_substeps = 0;
    world
}

/// Returns position, orientation, linear and angular velocity of a body.
fn numbers(body: &RigidBody) -> [f32; 13] {
    let (position, orientation) = (body.translation(), body.rotation());
    let (linear, angular) = (body.linvel(), body.angvel());
    let mut numbers = [0.0; 13];
    numbers[0..3].copy_from_slice(&position.to_array());
    numbers[3..7].copy_from_slice(&orientation.to_array());
    numbers[7..10].copy_from_slice(&linear.to_array());
    numbers[10..13].copy_from_slice(&angular.to_array());
    numbers
}

/// Moves the bodies of a multibody to where the coordinates of its joints put them. Rapier's own `update_rigid_bodies`
/// would leave the colliders where they were until after the next step.
pub(crate) fn place_links(multibody: &mut Multibody, bodies: &mut RigidBodySet) {
    multibody.forward_kinematics(bodies, true);
    for link in multibody.links() {
        bodies[link.rigid_body_handle()].set_position(*link.local_to_world(), false);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rapier3d::prelude::{ColliderBuilder, RigidBodyBuilder};

    const DYNAMICS: Dynamics = Dynamics {
        timestep_s: 0.01,
        solver_iterations: 4,
        contact_prediction_m: 0.02,
        contact_softness: SpringCoefficients { natural_frequency: 60.0, damping_ratio: 10.0 },
        friction_model: FrictionModel::Simplified,
    };

    /// Builds a world in which a ball falls onto a floor.
    fn ball_on_floor() -> (Physics, RigidBodyHandle) {
        Physics::build(
            DYNAMICS,
            &["floor", "ball"],
            |world| {
                let floor = ColliderBuilder::cuboid(1.0, 1.0, 0.1);
                world.insert(RigidBodyBuilder::fixed(), floor);
                let ball = RigidBodyBuilder::dynamic().translation(Vector::new(0.0, 0.0, 0.5));
                world.insert(ball.can_sleep(false), ColliderBuilder::ball(0.1)).0
            },
            |world, ball| {
                world.bodies[*ball].set_angvel(Vector::new(3.0, 0.0, 0.0), true);
            },
        )
    }

    fn hash(physics: &Physics) -> u64 {
        let mut hasher = Xxh3::new();
        physics.hash(&mut hasher);
        hasher.digest()
    }

    fn hashes(physics: &mut Physics, steps: usize) -> Vec<u64> {
        let mut hashes = vec![hash(physics)];
        for _ in 0..steps {
            physics.step();
            hashes.push(hash(physics));
        }
        hashes
    }

    #[test]
    fn a_restored_world_repeats_itself_amid_a_contact() {
        let (mut physics, _) = ball_on_floor();
        let first = hashes(&mut physics, 100);
        assert!(first.windows(2).all(|pair| pair[0] != pair[1]), "every step counts");
        for steps in [0, 1, 40, 100] {
            physics.restore();
            hashes(&mut physics, steps);
            physics.restore();
            assert_eq!(first, hashes(&mut physics, 100), "after {steps} steps");
        }
    }

    #[test]
    fn building_takes_no_time() {
        let (physics, ball) = ball_on_floor();
        assert_eq!(physics.world.bodies[ball].translation().z, 0.5);
        assert_eq!(physics.world.bodies[ball].linvel(), Vector::ZERO);
    }

    #[test]
    fn a_body_that_leaves_the_finite_numbers_is_named() {
        let (mut physics, ball) = ball_on_floor();
        physics.step();
        assert_eq!(physics.check_finite(1), Ok(()));
        physics.world.bodies[ball].add_force(Vector::new(f32::INFINITY, 0.0, 0.0), true);
        physics.step();
        physics.step();
        assert_eq!(
            physics.check_finite(2).unwrap_err().to_string(),
            "expected finite numbers in the state, found NaN in ball at step 2"
        );
        physics.restore();
        assert_eq!(physics.check_finite(0), Ok(()));
    }
}
