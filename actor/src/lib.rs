//! The actor: acts in environments and publishes trajectories. It does not learn.
//!
//! [`rollout`] is the actor process of a training run. [`replay`] is its counterpart that takes the
//! trajectories from a log; [`publish`] puts a log onto the bus for any reader. [`demonstrate`], [`evaluate`],
//! [`verify`], [`restore`], `scenes`, `audit` and `serve` work without a bus. [`episode`] and [`lane`] turn a
//! lease into trajectories, [`policy`] chooses the actions, `pace` decides how many lanes are stepped at once,
//! and [`resimulate`] re-simulates recorded episodes.
//!
//! An actor for your own tasks is a program whose `main` calls [`main()`] with their [`Registration`]s; the
//! task file names the program. `deploy/examples/reacher/` is an example.

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
