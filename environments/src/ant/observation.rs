//! What the agent sees: coordinates and velocities of the ant and of the goal, contact forces, and
//! the way to the goal.

use super::anatomy::State;
use super::contact::Forces;
use protocol::task::write_floats;
use rapier3d::prelude::{Rotation, Vector};

/// The mark of the goal. It stands still and touches nothing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Goal {
    /// Its place in the world, meters.
    pub(super) position: Vector,
    /// Turns its axes into the world's; only seen.
    pub(super) orientation: Rotation,
}

impl Goal {
    /// Before the first episode.
    pub(super) const NOWHERE: Goal =
        Goal { position: Vector::ZERO, orientation: Rotation::IDENTITY };

    /// From a point to the goal along x and y, meters.
    pub(super) fn from(&self, point: Vector) -> [f32; 2] {
        [self.position.x - point.x, self.position.y - point.y]
    }
}

/// Writes the 132 numbers that the table of the module names.
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

/// The numbers of a quaternion as the authors' simulator orders them: w, x, y, z.
fn scalar_first(rotation: Rotation) -> [f32; 4] {
    [rotation.w, rotation.x, rotation.y, rotation.z]
}
