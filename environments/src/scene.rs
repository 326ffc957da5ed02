//! What a viewer draws of an environment: solids that never change, and poses that do.

/// A solid that a viewer draws.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solid {
    /// Its name, unique in the task.
    pub name: &'static str,
    /// Its shape, around its own origin.
    pub shape: Shape,
    /// Red, green, blue and opacity, each in [0, 1].
    pub color: [f32; 4],
}

/// A shape, meters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// A box.
    Cuboid {
        /// Half of its sides.
        half_extents: [f32; 3],
    },
    /// A ball.
    Ball {
        /// Its radius.
        radius: f32,
    },
    /// A capsule along its own z axis.
    Capsule {
        /// Radius of the tube and of its ends.
        radius: f32,
        /// Half of the distance between the centers of its ends.
        half_length: f32,
    },
}

/// Where a solid is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Position of its origin in the world, meters.
    pub position: [f32; 3],
    /// Unit quaternion x, y, z, w that turns its axes into the world's.
    pub orientation: [f32; 4],
}
