//! What a viewer draws of an environment: a constant set of solids and their current poses.

/// A solid that a viewer draws.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solid {
    /// Name, unique in the task.
    pub name: &'static str,
    /// Shape, centered at the solid's own origin.
    pub shape: Shape,
    /// Red, green, blue and opacity, each in [0, 1].
    pub color: [f32; 4],
}

/// A shape, in meters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// A box.
    Cuboid {
        /// Half of the side lengths.
        half_extents: [f32; 3],
    },
    /// A ball.
    Ball {
        /// Radius.
        radius: f32,
    },
    /// A capsule along the solid's own z axis.
    Capsule {
        /// Radius of the cylinder and of the end caps.
        radius: f32,
        /// Half of the distance between the centers of the end caps.
        half_length: f32,
    },
}

/// Position and orientation of a solid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Position of the solid's origin in the world, meters.
    pub position: [f32; 3],
    /// Unit quaternion x, y, z, w that rotates the solid's axes into the world's.
    pub orientation: [f32; 4],
}
