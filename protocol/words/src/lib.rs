//! The vocabulary shared by all processes of Goalward. This crate knows no algorithm and no process.
//!
//! [`task`] describes a task's observations and actions, [`trajectory`] and [`messages`] what processes send each
//! other, [`policy`] and [`weights`] a policy, [`seed`] the random streams, [`build`] the build that made a file, and
//! [`durable`] how files are written.

pub mod build;
pub mod description;
pub mod digest;
pub mod dropped;
pub mod durable;
pub mod encoder;
pub mod ending;
pub mod error;
pub mod messages;
pub mod policy;
pub mod scene;
pub mod seed;
pub mod setting;
pub mod table;
pub mod task;
pub mod tensors;
pub mod trajectory;
pub mod weights;

pub use error::Error;

/// Maximum number of actors in a run. Shared memory is reserved for this many; 64 saturate the machines we know.
pub const MAX_ACTORS: usize = 64;
