//! The actor: acts in environments and publishes trajectories. It does not learn.
//!
//! `rollout` is the actor process of a training run. `replay` is its counterpart that takes the trajectories from a
//! log; `publish` puts a log onto the bus for any reader. [`demonstrate`], `evaluate`, `verify`, `restore`, `scenes`,
//! `audit` and `serve` work without a bus. [`episode`] and [`lane`] turn a lease into trajectories, [`policy`] chooses
//! the actions, `pace` decides how many lanes are stepped at once, and `resimulate` re-simulates recorded episodes.
//!
//! An actor for your own tasks is a program whose `main` calls [`main()`] with their [`Registration`]s; the
//! task file names the program. `deploy/examples/reacher/` is an example.

mod audit;
pub mod cli;
pub mod demonstrate;
mod describe;
mod drawing;
pub mod episode;
mod evaluate;
pub mod expert;
mod export;
pub mod factory;
mod frame;
mod golden;
pub mod lane;
mod pace;
pub mod policy;
mod ports;
mod publish;
pub mod python;
mod replay;
mod resimulate;
mod restore;
mod rollout;
mod scenes;
mod serve;
mod verify;

pub use cli::main;
pub use environments::{
    BUILT_IN, Environment, EnvironmentError, Expert, Registration, Setting, Step, check_action,
};
