//! The contact forces of the observation: torque and force of the floor on every part of the ant.
//!
//! Each body of the authors' model has one row of six numbers. Torques are about the center of mass of the whole ant.
//! Torques and forces are along the world's axes, averaged over the last timestep.
//!
//! | row | body |
//! |---|---|
//! | 0 | world, always zeros |
//! | 1 | torso |
//! | 2, 5, 8, 11 | hips 1 to 4 |
//! | 3, 6, 9, 12 | legs 1 to 4 |
//! | 4, 7, 10, 13 | feet 1 to 4 |
//! | 14 | goal, always zeros: it is a mark that nothing touches |

use super::body::Body;
use rapier3d::prelude::{ContactManifold, PhysicsWorld, Vector};
use rapier3d::utils::OrthonormalBasis;

/// Number of rows.
pub(super) const ROWS: usize = 15;

/// Torque, newton meters, and force, newtons, on each body.
pub(super) type Forces = [[f32; 6]; ROWS];

/// The forces on an ant that touches nothing.
pub(super) const NONE: Forces = [[0.0; 6]; ROWS];

/// Computes the forces of the last timestep.
pub(super) fn forces(world: &PhysicsWorld, body: &Body) -> Forces {
    let center = center_of_mass(world, body);
    let per_second = world.integration_parameters.inv_dt();
    let mut forces = NONE;
    for pair in world.contact_pairs_with(body.floor) {
        let floor_first = pair.collider1 == body.floor;
        let part = if floor_first { pair.collider2 } else { pair.collider1 };
        let row = &mut forces[world.colliders[part].user_data as usize];
        // Rapier's impulses act on the first collider of the pair.
        let sign = if floor_first { -per_second } else { per_second };
        for manifold in pair.solver_manifolds() {
            for (point, impulse) in impulses(world, manifold) {
                let force = impulse * sign;
                let torque = (point - center).cross(force);
                for (sum, part) in
                    row.iter_mut().zip(torque.to_array().into_iter().chain(force.to_array()))
                {
                    *sum += part;
                }
            }
        }
    }
    forces
}

/// Returns where a manifold pushed its first body in the last timestep, and with what impulse.
fn impulses<'world>(
    world: &'world PhysicsWorld,
    manifold: &'world ContactManifold,
) -> impl Iterator<Item = (Vector, Vector)> + 'world {
    let normal = -manifold.data.normal;
    let tangent = normal.orthonormal_vector();
    let bitangent = normal.cross(tangent);
    manifold.data.solver_contacts.iter().map(move |contact| {
        let (on_first, on_second) =
            manifold.data.solver_contact_world_points(contact, &world.bodies);
        let data = &manifold.points[contact.contact_indices()[0] as usize].data;
        let impulse = normal * data.impulse
            + tangent * data.tangent_impulse.x
            + bitangent * data.tangent_impulse.y;
        ((on_first + on_second) * 0.5, impulse)
    })
}

fn center_of_mass(world: &PhysicsWorld, body: &Body) -> Vector {
    let (mut moment, mut mass) = (Vector::ZERO, 0.0);
    for link in &body.links {
        let link = &world.bodies[*link];
        moment += link.center_of_mass() * link.mass();
        mass += link.mass();
    }
    moment / mass
}

#[cfg(test)]
mod tests {
    use super::super::anatomy::{State, TORSO_ROW, limb_rows};
    use super::super::body;
    use super::*;
    use protocol::seed::{Purpose, stream};
    use rand::RngExt;

    /// Returns an ant that has stood still for five seconds.
    fn standing() -> (PhysicsWorld, Body) {
        let (mut physics, body) = body::build();
        body.place(&mut physics.world, &State::start());
        for _ in 0..250 {
            physics.step();
        }
        (physics.world, body)
    }

    #[test]
    fn the_floor_carries_the_weight_of_a_standing_ant() {
        let (world, body) = standing();
        let forces = forces(&world, &body);
        let weight = 0.91088 * 9.81;
        let carried: f32 = forces.iter().map(|row| row[5]).sum();
        assert!((carried / weight - 1.0).abs() < 0.02, "{carried} N of {weight} N");
        for axis in 0..5 {
            let sum: f32 = forces.iter().map(|row| row[axis]).sum();
            assert!(sum.abs() < 0.05, "axis {axis} of a body at rest: {sum}");
        }
    }

    #[test]
    fn an_ant_stands_on_its_feet() {
        let (world, body) = standing();
        let forces = forces(&world, &body);
        for (row, force) in forces.iter().enumerate() {
            let is_foot = (0..4).any(|leg| limb_rows(leg)[2] == row);
            assert_eq!(force[5] > 1.0, is_foot, "row {row}: {force:?}");
        }
        // A force upward at +x turns about -y.
        let [_, _, front_left] = limb_rows(0);
        assert!(forces[front_left][0] > 0.5 && forces[front_left][1] < -0.5, "{forces:?}");
    }

    /// The momentum that the floor gives to a leaping ant equals the momentum it gains plus what gravity takes.
    #[test]
    fn forces_balance_the_momentum() {
        let (mut physics, body) = body::build();
        let mut draws = stream(1, Purpose::TrainingActions, 0, 0);
        let mut state = State::start();
        state.velocity = Vector::new(0.5, 0.0, 0.0);
        body.place(&mut physics.world, &state);
        let (mass, timestep_s, timesteps) = (0.91088, 0.02, 500);
        let mut velocities = Vec::new();
        let mut given = Vector::ZERO;
        for timestep in 0..timesteps {
            let before = center_of_mass(&physics.world, &body);
            if timestep % 5 == 0 {
                let torques = std::array::from_fn(|_| draws.random_range(-150.0..150.0));
                body.drive(&mut physics.world, &torques);
            }
            physics.step();
            for row in forces(&physics.world, &body) {
                given += Vector::new(row[3], row[4], row[5]) * timestep_s;
            }
            velocities.push((center_of_mass(&physics.world, &body) - before) / timestep_s);
        }
        given.z -= mass * 9.81 * timestep_s * timesteps as f32;
        let gained = (velocities[timesteps - 1] - velocities[0]) * mass;
        // Two percent of the 89 N s that gravity takes in ten seconds: the substeps lose that much.
        assert!(given.distance(gained) < 1.8, "{given} N s given, {gained} N s gained");
    }

    #[test]
    fn feet_that_slide_feel_as_much_friction_as_weight() {
        let (mut physics, body) = body::build();
        let mut state = State::start();
        state.velocity = Vector::new(2.0, 0.0, 0.0);
        body.place(&mut physics.world, &state);
        physics.step();
        let forces = forces(&physics.world, &body);
        // The ant tips forward and lifts its other two feet.
        for [_, _, _, x, y, z] in [0, 3].map(|leg| forces[limb_rows(leg)[2]]) {
            assert!(z > 1.0 && (x / z + 1.0).abs() < 0.1 && (y / z).abs() < 0.1, "{x} {y} {z}");
        }
    }

    #[test]
    fn a_torso_on_the_floor_has_the_second_row() {
        let (mut physics, body) = body::build();
        let mut state = State::start();
        state.position.z = 0.24;
        // Feet up.
        state.orientation = rapier3d::prelude::Rotation::from_xyzw(1.0, 0.0, 0.0, 0.0);
        body.place(&mut physics.world, &state);
        physics.step();
        let forces = forces(&physics.world, &body);
        assert!(forces[TORSO_ROW][5] > 1.0, "{forces:?}");
        for leg in 0..4 {
            assert_eq!(forces[limb_rows(leg)[2]], [0.0; 6], "a foot in the air");
        }
    }
}
