//! What all processes of Goalward agree on; it knows no algorithm.
//!
//! [`task`] says what a task's observations and actions look like, [`trajectory`] and [`messages`]
//! what travels, [`bus`] how it travels (the only module that names iceoryx2), [`log`] how it is
//! kept (the only one that names mcap), [`provenance`] which build made it, [`checkpoint`] where a run
//! goes on from, [`config`] what it is, [`mod@demonstrations`] what it learns from
//! and [`seed`] where its randomness comes from.

pub mod bus;
pub mod checkpoint;
pub mod config;
pub mod demonstrations;
pub mod diagnostics;
pub mod digest;
pub mod dropped;
pub mod durable;
pub mod error;
pub mod headway;
pub mod learning_rate;
pub mod log;
pub mod messages;
pub mod origin;
pub mod process;
pub mod provenance;
pub mod run;
pub mod scene;
pub mod seed;
pub mod setting;
pub mod summary;
mod table;
pub mod task;
pub mod tensors;
pub mod trajectory;
pub mod weights;

pub use error::Error;
