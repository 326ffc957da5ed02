//! Solids of a recorded scene as geometry, and the camera that looks at them.
//!
//! The camera is infinitely far away (parallel projection), so a solid is drawn at the same size wherever it is.

use protocol::scene::{Color, Pose, SceneUpdate, Vector3};

/// A point or a direction in the world, meters.
pub(crate) type Vector = [f64; 3];

/// A convex solid.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Solid {
    /// Name of the entity that it is a part of.
    pub(crate) name: String,
    /// Its shape in world coordinates.
    pub(crate) shape: Shape,
    /// Red, green, blue and opacity, each in [0, 1].
    pub(crate) color: [f64; 4],
}

/// A shape in world coordinates.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Shape {
    /// A box.
    Box {
        /// Its center.
        center: Vector,
        /// Its three axes, each half as long as the side.
        halves: [Vector; 3],
    },
    /// A ball.
    Ball {
        /// Its center.
        center: Vector,
        /// Its radius.
        radius: f64,
    },
    /// A cylinder.
    Cylinder {
        /// Centers of its ends.
        ends: [Vector; 2],
        /// Its radius.
        radius: f64,
    },
}

impl Solid {
    /// Returns the solids of a scene.
    pub(crate) fn all(scene: &SceneUpdate) -> Vec<Solid> {
        let mut solids = Vec::new();
        for entity in &scene.entities {
            let mut add = |shape: Option<Shape>, color: Option<Color>| {
                let color = color.map_or([0.5, 0.5, 0.5, 1.0], |Color { r, g, b, a }| [r, g, b, a]);
                let name = entity.id.clone();
                solids.extend(shape.map(|shape| Solid { name, shape, color }));
            };
            for cube in &entity.cubes {
                add(cuboid(cube.pose, cube.size), cube.color);
            }
            for sphere in &entity.spheres {
                add(ball(sphere.pose, sphere.size), sphere.color);
            }
            for tube in &entity.cylinders {
                add(cylinder(tube.pose, tube.size), tube.color);
            }
        }
        solids
    }

    /// Returns the center.
    pub(crate) fn center(&self) -> Vector {
        match self.shape {
            Shape::Box { center, .. } | Shape::Ball { center, .. } => center,
            Shape::Cylinder { ends: [one, other], .. } => scaled(sum(one, other), 0.5),
        }
    }

    /// Returns how far it extends from its center along a unit direction, both ways; a cylinder as if its ends were
    /// round.
    pub(crate) fn reach(&self, direction: Vector) -> f64 {
        match self.shape {
            Shape::Box { halves, .. } => {
                halves.iter().map(|half| dot(*half, direction).abs()).sum()
            }
            Shape::Ball { radius, .. } => radius,
            Shape::Cylinder { ends: [one, other], radius } => {
                dot(difference(one, other), direction).abs() / 2.0 + radius
            }
        }
    }

    /// Returns the faces of a box: outward unit normals, with the distance of the face from the world's origin along
    /// them. Other shapes have none.
    pub(crate) fn faces(&self) -> Vec<(Vector, f64)> {
        let Shape::Box { center, halves } = self.shape else { return Vec::new() };
        let face = |half: Vector| {
            let length = dot(half, half).sqrt().max(1e-12);
            let normal = scaled(half, 1.0 / length);
            (normal, dot(center, normal) + length)
        };
        halves.into_iter().flat_map(|half| [half, scaled(half, -1.0)]).map(face).collect()
    }
}

/// A camera infinitely far away.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Camera {
    /// To the right in the picture.
    right: Vector,
    /// Upward in the picture.
    up: Vector,
    /// From the scene to the camera.
    pub(crate) toward: Vector,
}

impl Camera {
    /// Returns a camera that looks from `azimuth`, measured from the x axis, down by `elevation`; both in degrees.
    pub(crate) fn looking_from(azimuth: f64, elevation: f64) -> Camera {
        let (azimuth, elevation) = (azimuth.to_radians(), elevation.to_radians());
        let (flat, high) = (elevation.cos(), elevation.sin());
        let toward = [flat * azimuth.cos(), flat * azimuth.sin(), high];
        let right = [-azimuth.sin(), azimuth.cos(), 0.0];
        Camera { right, up: cross(toward, right), toward }
    }

    /// Returns where a point is in the picture: to the right and downward, meters.
    pub(crate) fn place(&self, point: Vector) -> [f64; 2] {
        [dot(point, self.right), -dot(point, self.up)]
    }

    /// Returns a rectangle in the picture that contains a solid: its smallest and largest coordinates.
    pub(crate) fn extent(&self, solid: &Solid) -> [[f64; 2]; 2] {
        let [x, y] = self.place(solid.center());
        let (wide, high) = (solid.reach(self.right), solid.reach(self.up));
        [[x - wide, y - high], [x + wide, y + high]]
    }
}

fn cuboid(pose: Option<Pose>, size: Option<Vector3>) -> Option<Shape> {
    let ([x, y, z], size) = (axes(pose?)?, size?);
    let halves = [scaled(x, size.x / 2.0), scaled(y, size.y / 2.0), scaled(z, size.z / 2.0)];
    Some(Shape::Box { center: position(pose?)?, halves })
}

fn ball(pose: Option<Pose>, size: Option<Vector3>) -> Option<Shape> {
    Some(Shape::Ball { center: position(pose?)?, radius: size?.x / 2.0 })
}

fn cylinder(pose: Option<Pose>, size: Option<Vector3>) -> Option<Shape> {
    let (center, [.., along], size) = (position(pose?)?, axes(pose?)?, size?);
    let half = scaled(along, size.z / 2.0);
    let ends = [difference(center, half), sum(center, half)];
    Some(Shape::Cylinder { ends, radius: size.x / 2.0 })
}

fn position(pose: Pose) -> Option<Vector> {
    let Vector3 { x, y, z } = pose.position?;
    Some([x, y, z])
}

/// Returns a pose's axes in world coordinates.
fn axes(pose: Pose) -> Option<[Vector; 3]> {
    let turn = pose.orientation?;
    let (x, y, z, w) = (turn.x, turn.y, turn.z, turn.w);
    Some([
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)],
        [2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)],
        [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)],
    ])
}

/// Returns the scalar product.
pub(crate) fn dot(one: Vector, other: Vector) -> f64 {
    one.iter().zip(other).map(|(one, other)| one * other).sum()
}

/// Returns the sum.
pub(crate) fn sum(one: Vector, other: Vector) -> Vector {
    std::array::from_fn(|axis| one[axis] + other[axis])
}

fn difference(one: Vector, other: Vector) -> Vector {
    sum(one, scaled(other, -1.0))
}

/// Returns the vector multiplied by `factor`.
pub(crate) fn scaled(vector: Vector, factor: f64) -> Vector {
    vector.map(|number| factor * number)
}

fn cross(one: Vector, other: Vector) -> Vector {
    let [a, b, c] = one;
    let [x, y, z] = other;
    [b * z - c * y, c * x - a * z, a * y - b * x]
}

#[cfg(test)]
mod tests {
    use protocol::scene::{Primitive, Quaternion, SceneEntity};

    use super::*;

    #[test]
    fn a_turned_box_lies_where_its_pose_says() {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let pose = Pose {
            position: Some(Vector3 { x: 1.0, y: 2.0, z: 3.0 }),
            // A quarter turn about z maps its x axis to the world's y axis.
            orientation: Some(Quaternion { x: 0.0, y: 0.0, z: half, w: half }),
        };
        let size = Some(Vector3 { x: 4.0, y: 2.0, z: 1.0 });
        let cube = Primitive { pose: Some(pose), size, color: None };
        let entity = SceneEntity { cubes: vec![cube], ..SceneEntity::default() };
        let solids = Solid::all(&SceneUpdate { entities: vec![entity] });
        let reaches =
            [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|d| solids[0].reach(d));
        for (found, expected) in reaches.into_iter().zip([1.0, 2.0, 0.5]) {
            assert!((found - expected).abs() < 1e-12, "{reaches:?}");
        }
        let top = solids[0].faces().into_iter().find(|(normal, _)| normal[2] > 0.5).unwrap();
        assert!((top.1 - 3.5).abs() < 1e-12, "{top:?}");
    }

    #[test]
    fn the_camera_sees_up_as_up() {
        let camera = Camera::looking_from(-60.0, 30.0);
        let [[x, low], [same, high]] =
            [[1.0, 1.0, 0.0], [1.0, 1.0, 1.0]].map(|at| camera.place(at));
        assert!((x - same).abs() < 1e-12 && high < low);
        assert!(camera.toward[2] > 0.0 && camera.toward[1] < 0.0);
    }
}
