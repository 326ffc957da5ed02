//! The solids of an episode and their poses at each observation, in the form that a browser draws.

use protocol::scene::{Color, Pose, Quaternion, SceneUpdate, Vector3};
use serde::Serialize;

/// Factor for rounding: numbers keep five decimal places.
const DIGITS: f64 = 1e5;

/// The parts of a scene, and their poses in each frame.
#[derive(Debug, PartialEq, Serialize)]
pub(crate) struct Scenes {
    parts: Vec<Part>,
    /// For each part seven numbers: its position (x, y, z) in meters and its orientation as a quaternion (x, y, z, w).
    frames: Vec<Vec<f64>>,
}

#[derive(Debug, PartialEq, Serialize)]
struct Part {
    name: String,
    shape: Shape,
    /// Side lengths or diameters, meters.
    size: [f64; 3],
    color: [f64; 4],
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
enum Shape {
    Cube,
    Sphere,
    /// A cylinder along its own z axis.
    Cylinder,
}

impl Scenes {
    /// Converts the frames of an episode; returns `None` if there are none.
    pub(crate) fn of(updates: &[SceneUpdate]) -> Option<Scenes> {
        let parts = parts(updates.first()?).into_iter().map(|(part, _)| part).collect();
        let frame = |update| parts_places(update).collect();
        Some(Scenes { parts, frames: updates.iter().map(frame).collect() })
    }
}

fn parts_places(update: &SceneUpdate) -> impl Iterator<Item = f64> {
    parts(update).into_iter().flat_map(|(_, place)| place)
}

fn parts(update: &SceneUpdate) -> Vec<(Part, [f64; 7])> {
    let mut found = Vec::new();
    for entity in &update.entities {
        let mut add = |shape, size: Option<Vector3>, color: Option<Color>, pose: Option<Pose>| {
            let Vector3 { x, y, z } = size.unwrap_or_default();
            let Color { r, g, b, a } = color.unwrap_or_default();
            let (size, color) = ([x, y, z].map(rounded), [r, g, b, a].map(rounded));
            found.push((Part { name: entity.id.clone(), shape, size, color }, place(pose)));
        };
        for cube in &entity.cubes {
            add(Shape::Cube, cube.size, cube.color, cube.pose);
        }
        for sphere in &entity.spheres {
            add(Shape::Sphere, sphere.size, sphere.color, sphere.pose);
        }
        for cylinder in &entity.cylinders {
            add(Shape::Cylinder, cylinder.size, cylinder.color, cylinder.pose);
        }
    }
    found
}

fn place(pose: Option<Pose>) -> [f64; 7] {
    let pose = pose.unwrap_or_default();
    let Vector3 { x, y, z } = pose.position.unwrap_or_default();
    let upright = Quaternion { w: 1.0, ..Quaternion::default() };
    let turned = pose.orientation.unwrap_or(upright);
    [x, y, z, turned.x, turned.y, turned.z, turned.w].map(rounded)
}

fn rounded(number: f64) -> f64 {
    (number * DIGITS).round() / DIGITS
}

#[cfg(test)]
mod tests {
    use protocol::scene::{Primitive, SceneEntity};

    use super::*;

    #[test]
    fn parts_are_told_once_and_places_for_every_frame() {
        let at = |x: f64| {
            let position = Some(Vector3 { x, y: 0.0, z: 0.123_456_7 });
            let ball = Primitive {
                pose: Some(Pose { position, orientation: None }),
                size: Some(Vector3 { x: 0.5, y: 0.5, z: 0.5 }),
                color: None,
            };
            let entity = SceneEntity {
                id: "ball".to_owned(),
                spheres: vec![ball],
                ..SceneEntity::default()
            };
            SceneUpdate { entities: vec![entity] }
        };
        let scenes = Scenes::of(&[at(1.0), at(2.0)]).unwrap();
        assert_eq!((scenes.parts.len(), scenes.parts[0].shape), (1, Shape::Sphere));
        assert_eq!(scenes.frames[1], [2.0, 0.0, 0.123_46, 0.0, 0.0, 0.0, 1.0]);
        assert_eq!(Scenes::of(&[]), None);
    }
}
