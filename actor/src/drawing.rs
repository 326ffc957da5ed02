//! Episodes for viewers: an episode is re-simulated from its seeds and actions, and the poses of the
//! environment's solids after each step, or the pictures that it renders, are recorded.

use anyhow::{Result, ensure};
use environments::{Environment, Pose, Shape, Solid};
use mcap_log::{FileWriter, Topic};
use prost::Message;
use protocol::scene::{
    self, Color, CompressedImage, CylinderPrimitive, FRAME, FRAME_NS, Primitive, Quaternion,
    SceneEntity, SceneUpdate, Timestamp, Vector3,
};
use protocol::trajectory::Trajectory;

use crate::episode::EpisodeName;

/// Maximum number of pictures per episode.
const MOST_PICTURES: u32 = 120;

/// Records the scenes of an episode, the first at `start_ns`; returns the time after the last. A task without
/// solids has no scenes. If the environment renders pictures, they are recorded at regular intervals.
///
/// # Errors
/// When the environment fails or does not end in the recorded state, or the disk refuses the scenes.
pub(crate) fn draw(
    writer: &mut FileWriter,
    environment: &mut dyn Environment,
    trajectory: &Trajectory,
    start_ns: u64,
) -> Result<u64> {
    let name = EpisodeName::of(trajectory)?;
    let [mut starts, _] = name.streams();
    let spec = environment.spec();
    let mut observation = vec![0; spec.observation.bytes()];
    let mut poses = Vec::new();
    let mut time_ns = start_ns;
    environment.reset(&mut starts, &mut observation)?;
    let mut first = environment.picture()?;
    if environment.solids().is_empty() && first.is_none() {
        return Ok(start_ns);
    }
    let mut picture = |environment: &mut dyn Environment| match first.take() {
        Some(first) => Ok(Some(first)),
        None => environment.picture(),
    };
    let states_per_picture = u64::from(trajectory.steps / MOST_PICTURES + 1);
    let mut frame = |environment: &mut dyn Environment| -> Result<()> {
        if !environment.solids().is_empty() {
            poses.clear();
            environment.append_poses(&mut poses);
            let update = scene(environment.solids(), &poses, time_ns);
            writer.message(Topic::Scene, time_ns, &update.encode_to_vec())?;
        }
        let state = (time_ns - start_ns) / FRAME_NS;
        if state.is_multiple_of(states_per_picture)
            && let Some(picture) = picture(environment)?
        {
            let image = image(picture, time_ns);
            writer.message(Topic::Picture, time_ns, &image.encode_to_vec())?;
        }
        time_ns += FRAME_NS;
        Ok(())
    };
    frame(environment)?;
    for action in trajectory.actions().chunks_exact(spec.action.bytes()) {
        environment.step(action, &mut observation)?;
        frame(environment)?;
    }
    let found = environment.state_hash();
    ensure!(
        found == trajectory.state_hash,
        "lane {} episode {}: expected the recorded state {:016x}, found {found:016x}",
        name.lane,
        name.episode,
        trajectory.state_hash
    );
    Ok(time_ns)
}

fn scene(solids: &[Solid], poses: &[Pose], time_ns: u64) -> SceneUpdate {
    let entities = solids.iter().zip(poses).map(|(solid, pose)| entity(solid, pose, time_ns));
    SceneUpdate { entities: entities.collect() }
}

fn image(picture: Vec<u8>, time_ns: u64) -> CompressedImage {
    CompressedImage {
        timestamp: Some(timestamp(time_ns)),
        data: picture.into(),
        format: "png".to_owned(),
        frame_id: FRAME.to_owned(),
    }
}

fn timestamp(time_ns: u64) -> Timestamp {
    let second = 1_000_000_000;
    Timestamp { seconds: (time_ns / second) as i64, nanos: (time_ns % second) as i32 }
}

fn entity(solid: &Solid, pose: &Pose, time_ns: u64) -> SceneEntity {
    let mut entity = SceneEntity {
        timestamp: Some(timestamp(time_ns)),
        frame_id: FRAME.to_owned(),
        id: solid.name.to_owned(),
        ..SceneEntity::default()
    };
    let [r, g, b, a] = solid.color.map(f64::from);
    let color = Some(Color { r, g, b, a });
    let primitive = |pose: &Pose, half_size: [f32; 3]| Primitive {
        pose: Some(drawn(pose)),
        size: Some(vector(half_size.map(|half| 2.0 * half))),
        color,
    };
    match solid.shape {
        Shape::Cuboid { half_extents } => entity.cubes.push(primitive(pose, half_extents)),
        Shape::Ball { radius } => entity.spheres.push(primitive(pose, [radius; 3])),
        Shape::Capsule { radius, half_length } => {
            entity.cylinders.push(CylinderPrimitive {
                pose: Some(drawn(pose)),
                size: Some(vector([2.0 * radius, 2.0 * radius, 2.0 * half_length])),
                bottom_scale: 1.0,
                top_scale: 1.0,
                color,
            });
            for end in [-half_length, half_length] {
                entity.spheres.push(primitive(&moved_along_own_z(pose, end), [radius; 3]));
            }
        }
    }
    entity
}

fn moved_along_own_z(pose: &Pose, distance: f32) -> Pose {
    let [x, y, z, w] = pose.orientation;
    let own_z = [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)];
    let mut position = pose.position;
    position.iter_mut().zip(own_z).for_each(|(place, along)| *place += distance * along);
    Pose { position, ..*pose }
}

fn drawn(pose: &Pose) -> scene::Pose {
    let [x, y, z, w] = pose.orientation.map(f64::from);
    let orientation = Some(Quaternion { x, y, z, w });
    scene::Pose { position: Some(vector(pose.position)), orientation }
}

fn vector(numbers: [f32; 3]) -> Vector3 {
    let [x, y, z] = numbers.map(f64::from);
    Vector3 { x, y, z }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_capsule_is_a_cylinder_between_two_balls() {
        let half = std::f32::consts::FRAC_1_SQRT_2;
        let solid = Solid {
            name: "leg",
            shape: Shape::Capsule { radius: 0.25, half_length: 2.0 },
            color: [1.0, 0.5, 0.0, 1.0],
        };
        // A quarter turn about x maps the capsule's own z axis to the world's -y axis.
        let pose = Pose { position: [1.0, 2.0, 3.0], orientation: [half, 0.0, 0.0, half] };
        let entity = entity(&solid, &pose, 1_250_000_000);
        assert_eq!((entity.cylinders.len(), entity.spheres.len(), entity.cubes.len()), (1, 2, 0));
        let ends: Vec<f64> = entity
            .spheres
            .iter()
            .map(|ball| ball.pose.and_then(|pose| pose.position).map_or(f64::NAN, |place| place.y))
            .collect();
        assert!((ends[0] - 4.0).abs() < 1e-6 && ends[1].abs() < 1e-6, "{ends:?}");
        assert_eq!(entity.timestamp, Some(Timestamp { seconds: 1, nanos: 250_000_000 }));
    }
}
