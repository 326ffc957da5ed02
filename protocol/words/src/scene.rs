//! What a viewer draws of an episode: messages of Foxglove's scene and image (`schema/scene.proto`), recorded
//! beside evaluation episodes. Nothing is ever learned from them.

use prost::Message;
use prost::bytes::Bytes;

/// The frame that everything is drawn in: the environment's own world.
pub const FRAME: &str = "world";

/// Time between two frames, so that an episode is shown about as fast as it would happen.
pub const FRAME_NS: u64 = 50_000_000;

/// New places of solids; a solid drawn before under the same name is replaced.
#[derive(Clone, PartialEq, Message)]
pub struct SceneUpdate {
    /// The solids.
    #[prost(message, repeated, tag = "2")]
    pub entities: Vec<SceneEntity>,
}

/// A picture of a state, as the environment itself renders it.
#[derive(Clone, PartialEq, Eq, Message)]
pub struct CompressedImage {
    /// When it is so.
    #[prost(message, optional, tag = "1")]
    pub timestamp: Option<Timestamp>,
    /// A file.
    #[prost(bytes = "bytes", tag = "2")]
    pub data: Bytes,
    /// Its format, such as `png`.
    #[prost(string, tag = "3")]
    pub format: String,
    /// The frame of the camera.
    #[prost(string, tag = "4")]
    pub frame_id: String,
}

/// A solid.
#[derive(Clone, PartialEq, Message)]
pub struct SceneEntity {
    /// When it is there.
    #[prost(message, optional, tag = "1")]
    pub timestamp: Option<Timestamp>,
    /// The frame of its poses.
    #[prost(string, tag = "2")]
    pub frame_id: String,
    /// Its name.
    #[prost(string, tag = "3")]
    pub id: String,
    /// Boxes it consists of.
    #[prost(message, repeated, tag = "8")]
    pub cubes: Vec<Primitive>,
    /// Balls it consists of.
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
    /// The rest.
    #[prost(int32, tag = "2")]
    pub nanos: i32,
}

/// A box or a ball: `CubePrimitive` and `SpherePrimitive` of the schema have the same fields.
#[derive(Clone, PartialEq, Message)]
pub struct Primitive {
    /// Of its center.
    #[prost(message, optional, tag = "1")]
    pub pose: Option<Pose>,
    /// Its sides, or its diameters, meters.
    #[prost(message, optional, tag = "2")]
    pub size: Option<Vector3>,
    /// Its color.
    #[prost(message, optional, tag = "3")]
    pub color: Option<Color>,
}

/// A cylinder along its own z axis.
#[derive(Clone, PartialEq, Message)]
pub struct CylinderPrimitive {
    /// Of its center.
    #[prost(message, optional, tag = "1")]
    pub pose: Option<Pose>,
    /// Its diameters and its length, meters.
    #[prost(message, optional, tag = "2")]
    pub size: Option<Vector3>,
    /// Share of the diameter at its lower end.
    #[prost(double, tag = "3")]
    pub bottom_scale: f64,
    /// Share of the diameter at its upper end.
    #[prost(double, tag = "4")]
    pub top_scale: f64,
    /// Its color.
    #[prost(message, optional, tag = "5")]
    pub color: Option<Color>,
}

/// Position and orientation.
#[derive(Clone, Copy, PartialEq, Message)]
pub struct Pose {
    /// Position, meters.
    #[prost(message, optional, tag = "1")]
    pub position: Option<Vector3>,
    /// Orientation.
    #[prost(message, optional, tag = "2")]
    pub orientation: Option<Quaternion>,
}

/// Three numbers.
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

/// A color, each part in [0, 1].
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
