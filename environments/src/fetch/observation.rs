//! The agent's observation: sixteen numbers, none of them a velocity (Table 1 and the authors' code).

use super::scene::Scene;
use protocol::task::write_floats;
use rapier3d::glamx::EulerRot;
use rapier3d::prelude::{Rotation, Vector};

/// Writes the observation listed in the table of the parent module.
///
/// # Panics
/// When `observation` is not exactly 64 bytes long.
pub(super) fn write(scene: &Scene, goal: Vector, observation: &mut [u8]) {
    assert_eq!(observation.len(), 64, "the caller sizes the observation by the spec");
    let (grip, cube) = (scene.grip(), scene.cube());
    let numbers = grip
        .to_array()
        .into_iter()
        .chain(cube.to_array())
        .chain((cube - grip).to_array())
        .chain(scene.fingers())
        .chain(tilt(scene.cube_orientation()))
        .chain(goal.to_array());
    write_floats(numbers, observation);
}

/// Returns the rotations about x and y that, after one about z, rotate the world's axes into the cube's.
fn tilt(orientation: Rotation) -> [f32; 2] {
    let (about_x, about_y, _) = orientation.to_euler(EulerRot::XYZ);
    [about_x, about_y]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Computes the tilt from the entries of the rotation matrix, as Gym does.
    fn tilt_of_gym(orientation: Rotation) -> [f32; 2] {
        let third_column = orientation * Vector::Z;
        let [entry_02, entry_12, entry_22] = third_column.to_array();
        [
            -libm::atan2f(entry_12, entry_22),
            -libm::atan2f(-entry_02, libm::hypotf(entry_22, entry_12)),
        ]
    }

    #[test]
    fn the_tilt_is_that_of_gym() {
        assert_eq!(tilt(Rotation::IDENTITY), [0.0, 0.0]);
        for (x, y, z) in [(0.3, 0.0, 0.0), (0.0, -0.4, 0.0), (0.2, 0.5, 1.1), (-2.0, 1.0, -3.0)] {
            let orientation = Rotation::from_euler(EulerRot::XYZ, x, y, z);
            let (ours, gym) = (tilt(orientation), tilt_of_gym(orientation));
            for (ours, expected, gym) in [(ours[0], x, gym[0]), (ours[1], y, gym[1])] {
                assert!((ours - gym).abs() < 1e-5 && (ours - expected).abs() < 1e-5);
            }
        }
    }
}
