//! Environments of Python, as Gymnasium has them: `gym:ID`, `gym:module:ID` or `python:module:function`.
//!
//! A process of Python holds the environments of an actor; the process and actor exchange frames
//! over a socket. An actor announces the actions of all its lanes before it steps the first of them, so
//! that they travel in one turn. Leases, policies and random streams stay in the actor.
//!
//! | module | what it does |
//! |---|---|
//! | `child.py` | the process of Python |
//! | `spaces.py` | observations to bytes, bytes to actions |
//! | `link` | the process, its start and its end |
//! | `environment` | an environment of a slot |
//! | `purity` | whether episodes can be acted again |

mod environment;
mod link;
mod purity;

pub(crate) use environment::as_recorded;
pub use environment::{PythonSetting, RENDER, close, make};
pub use purity::purified;
