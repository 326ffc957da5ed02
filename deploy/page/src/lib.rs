//! The live page: runs, their curves and what they are, for browsers.
//!
//! It reads what lies in the runs' folders and asks nothing of their processes, so a run goes on as it would
//! without it. Everything a browser loads is in the program.
//!
//! | module | what it does |
//! |---|---|
//! | [`server`](mod@server) | the address, the routes, the answers |
//! | `guard` | who may ask |
//! | `assets` | the files of the page |
//! | `runs` | which runs there are, and how far each is |
//! | `listed` | runs in a list |
//! | `kept` | what was read of runs, until their files change |
//! | `curves` | what a run's log has of its updates |
//! | `details` | what a run is |

mod assets;
mod curves;
mod details;
mod guard;
mod kept;
mod listed;
mod runs;
mod server;

pub use server::{Server, Settings};
