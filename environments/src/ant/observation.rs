//! The agent's observation: coordinates and velocities of the ant and of the goal, contact forces, and the
//! displacement to the goal.

use super::anatomy::State;
use super::contact::Forces;
use protocol::task::write_floats;
use rapier3d::prelude::{Rotation, Vector};

/// The goal's mark. It is fixed, and nothing touches it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Goal {
    /// Position in the world, meters.
    pub(super) position: Vector,
    /// Rotation from the mark's axes to the world's. It is used only in the observation.
    pub(super) orientation: Rotation,
}

impl Goal {
    /// The goal before the first episode.
    pub(super) const NOWHERE: Goal =
        Goal { position: Vector::ZERO, orientation: Rotation::IDENTITY };

    /// Returns the displacement from a point to the goal along x and y, meters.
    pub(super) fn from(&self, point: Vector) -> [f32; 2] {
        [self.position.x - point.x, self.position.y - point.y]
    }
}

/// Writes the 132 numbers listed in the table of the parent module.
///
/// # Panics
/// When `observation` is not exactly 528 bytes long.
pub(super) fn write(state: &State, goal: &Goal, forces: &Forces, observation: &mut [u8]) {
    assert_eq!(observation.len(), 4 * 132, "the caller sizes the observation by the spec");
    let coordinates = [state.position.z]
        .into_iter()
        .chain(scalar_first(state.orientation))
        .chain(state.angles)
        .chain(goal.position.to_array())
        .chain(scalar_first(goal.orientation));
    let velocities = state
        .velocity
        .to_array()
        .into_iter()
        .chain(state.angular_velocity.to_array())
        .chain(state.rates)
        .chain([0.0; 6]);
    let forces = forces.iter().flatten().map(|number| number.clamp(-1.0, 1.0));
    let numbers = coordinates.chain(velocities).chain(forces).chain(goal.from(state.position));
    write_floats(numbers, observation);
}

/// Returns a quaternion in the order of the authors' simulator: w, x, y, z.
fn scalar_first(rotation: Rotation) -> [f32; 4] {
    [rotation.w, rotation.x, rotation.y, rotation.z]
}
