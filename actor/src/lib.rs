//! The actor: acts in environments and publishes trajectories; owns no learning.
//!
//! [`rollout`] is the process of a training run, [`replay`] its double that acts from a log;
//! [`publish`] puts a log onto the bus for anybody.
//! [`demonstrate`], [`evaluate`] and [`verify`] work without a bus. [`episode`] and [`lane`] turn a
//! lease into trajectories, [`policy`] chooses the actions.

pub mod cli;
pub mod demonstrate;
pub mod drawing;
pub mod episode;
pub mod evaluate;
pub mod expert;
pub mod lane;
pub mod policy;
pub mod ports;
pub mod publish;
pub mod replay;
pub mod rollout;
pub mod verify;
