//! The words that all processes of Goalward agree on; it knows no algorithm and no process.
//!
//! [`task`] says what a task's observations and actions look like, [`trajectory`] and [`messages`]
//! what travels, [`policy`] and [`weights`] what a policy is, [`seed`] where randomness comes from,
//! [`build`] what made a file, [`durable`] how a file is written.

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

/// Actors of one run; memory is reserved by this limit, and 64 fill the machines we know.
pub const MAX_ACTORS: usize = 64;
