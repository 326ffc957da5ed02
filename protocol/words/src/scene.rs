//! Scenes and images of an episode for viewers: Foxglove's messages (`schema/scene.proto`), recorded beside evaluation
//! episodes. Nothing is learned from them.

use prost::Message;
use prost::bytes::Bytes;

/// The coordinate frame of everything drawn: the environment's own world.
pub const FRAME: &str = "world";

/// Time between two frames, in nanoseconds, chosen so that episodes play at about real speed.
pub const FRAME_NS: u64 = 50_000_000;

/// New poses of solids. A solid replaces the earlier one with the same name.
#[derive(Clone, PartialEq, Message)]
pub struct SceneUpdate {
    /// The solids.
    #[prost(message, repeated, tag = "2")]
    pub entities: Vec<SceneEntity>,
}

/// An image of a state, rendered by the environment itself.
#[derive(Clone, PartialEq, Eq, Message)]
pub struct CompressedImage {
    /// Time of the state.
    #[prost(message, optional, tag = "1")]
    pub timestamp: Option<Timestamp>,
    /// The image file.
    #[prost(bytes = "bytes", tag = "2")]
    pub data: Bytes,
    /// Its format, such as `png`.
    #[prost(string, tag = "3")]
    pub format: String,
    /// The camera's coordinate frame.
    #[prost(string, tag = "4")]
    pub frame_id: String,
}

/// A solid.
#[derive(Clone, PartialEq, Message)]
pub struct SceneEntity {
    /// Time of its poses.
    #[prost(message, optional, tag = "1")]
    pub timestamp: Option<Timestamp>,
    /// The coordinate frame of its poses.
    #[prost(string, tag = "2")]
    pub frame_id: String,
    /// Its name.
    #[prost(string, tag = "3")]
    pub id: String,
    /// Boxes it consists of.
    #[prost(message, repeated, tag = "8")]
    pub cubes: Vec<Primitive>,
    /// Spheres it consists of.
    #[prost(message, repeated, tag = "9")]
    pub spheres: Vec<Primitive>,
    /// Cylinders it consists of.
    #[prost(message, repeated, tag = "10")]
    pub cylinders: Vec<CylinderPrimitive>,
}

/// Time since 1970, or since the beginning of the recording.
#[derive(Clone, Copy, PartialEq, Eq, Message)]
pub struct Timestamp {
    /// Whole seconds.
    #[prost(int64, tag = "1")]
    pub seconds: i64,
    /// Nanoseconds beyond the whole seconds.
    #[prost(int32, tag = "2")]
    pub nanos: i32,
}

/// A box or a sphere: `CubePrimitive` and `SpherePrimitive` of the schema have the same fields.
#[derive(Clone, PartialEq, Message)]
pub struct Primitive {
    /// Pose of its center.
    #[prost(message, optional, tag = "1")]
    pub pose: Option<Pose>,
    /// Its side lengths or diameters, in meters.
    #[prost(message, optional, tag = "2")]
    pub size: Option<Vector3>,
    /// Its color.
    #[prost(message, optional, tag = "3")]
    pub color: Option<Color>,
}

/// A cylinder along its own z axis.
#[derive(Clone, PartialEq, Message)]
pub struct CylinderPrimitive {
    /// Pose of its center.
    #[prost(message, optional, tag = "1")]
    pub pose: Option<Pose>,
    /// Its diameters and its length, in meters.
    #[prost(message, optional, tag = "2")]
    pub size: Option<Vector3>,
    /// Scale of the diameter at its lower end.
    #[prost(double, tag = "3")]
    pub bottom_scale: f64,
    /// Scale of the diameter at its upper end.
    #[prost(double, tag = "4")]
    pub top_scale: f64,
    /// Its color.
    #[prost(message, optional, tag = "5")]
    pub color: Option<Color>,
}

/// Position and orientation.
#[derive(Clone, Copy, PartialEq, Message)]
pub struct Pose {
    /// Position, in meters.
    #[prost(message, optional, tag = "1")]
    pub position: Option<Vector3>,
    /// Orientation.
    #[prost(message, optional, tag = "2")]
    pub orientation: Option<Quaternion>,
}

/// A vector in three dimensions.
#[derive(Clone, Copy, PartialEq, Message)]
pub struct Vector3 {
    /// Along x.
    #[prost(double, tag = "1")]
    pub x: f64,
    /// Along y.
    #[prost(double, tag = "2")]
    pub y: f64,
    /// Along z.
    #[prost(double, tag = "3")]
    pub z: f64,
}

/// A unit quaternion.
#[derive(Clone, Copy, PartialEq, Message)]
pub struct Quaternion {
    /// Along x.
    #[prost(double, tag = "1")]
    pub x: f64,
    /// Along y.
    #[prost(double, tag = "2")]
    pub y: f64,
    /// Along z.
    #[prost(double, tag = "3")]
    pub z: f64,
    /// The real part.
    #[prost(double, tag = "4")]
    pub w: f64,
}

/// A color, each component in [0, 1].
#[derive(Clone, Copy, PartialEq, Message)]
pub struct Color {
    /// Red.
    #[prost(double, tag = "1")]
    pub r: f64,
    /// Green.
    #[prost(double, tag = "2")]
    pub g: f64,
    /// Blue.
    #[prost(double, tag = "3")]
    pub b: f64,
    /// Opacity.
    #[prost(double, tag = "4")]
    pub a: f64,
}
