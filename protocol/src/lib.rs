//! What all processes of Goalward agree on; it knows no algorithm.
//!
//! [`task`] says what a task's observations and actions look like, [`trajectory`] and [`messages`]
//! what travels, [`bus`] how it travels (the only module that names iceoryx2), [`log`] how it is
//! kept (the only one that names mcap), [`config`] what a run is, [`mod@demonstrations`] what it learns from
//! and [`seed`] where its randomness comes from.

pub mod bus;
pub mod config;
pub mod demonstrations;
pub mod error;
pub mod learning_rate;
pub mod log;
pub mod messages;
pub mod process;
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
