//! Python environments with Gymnasium's interface: `gym:ID`, `gym:module:ID` or `python:module:function`.
//!
//! A Python process holds the environments of an actor; process and actor exchange frames over a socket. An
//! actor announces the actions of all its lanes before it steps the first of them, so that they travel in one
//! turn. Leases, policies and random streams stay in the actor.
//!
//! | module | what it does |
//! |---|---|
//! | `child.py` | the Python process |
//! | `spaces.py` | observations to bytes, bytes to actions |
//! | `link` | the process, its start and its end |
//! | `environment` | the environment of a slot |
//! | `purity` | whether episodes can be re-simulated |

mod environment;
mod link;
mod purity;

pub(crate) use environment::as_recorded;
pub use environment::{PythonSetting, RENDER, close, make};
pub use purity::purified;
