//! The actor: acts in environments and publishes trajectories; owns no learning.
//!
//! [`rollout`] is the process of a training run, [`replay`] its double that acts from a log;
//! [`publish`] puts a log onto the bus for anybody.
//! [`demonstrate`], [`evaluate`], [`verify`], [`restore`], `scenes`, `audit` and `serve` work without a bus. [`episode`] and [`lane`]
//! turn a lease into trajectories, [`policy`] chooses the actions, `pace` how many lanes at once, [`resimulate`] acts recorded ones.
//!
//! An actor of tasks of your own is a program with a `main` that calls [`main()`] with their
//! [`Registration`]s; a task's file names it. `deploy/examples/reacher/` is one.

mod audit;
pub mod cli;
pub mod demonstrate;
pub mod describe;
pub mod drawing;
pub mod episode;
pub mod evaluate;
pub mod expert;
pub mod export;
pub mod factory;
mod frame;
pub mod golden;
pub mod lane;
mod pace;
pub mod policy;
pub mod ports;
pub mod publish;
pub mod python;
pub mod replay;
pub mod resimulate;
pub mod restore;
pub mod rollout;
mod scenes;
mod serve;
pub mod verify;

pub use cli::main;
pub use environments::{
    BUILT_IN, Environment, EnvironmentError, Expert, Registration, Setting, Step, check_action,
};
