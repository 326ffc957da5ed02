//! The live page: runs, their curves and what they are, for browsers.
//!
//! It reads what lies in the runs' folders and asks nothing of their processes, so a run goes on as it would
//! without it. Everything a browser loads is in the program.
//!
//! | module | what it does |
//! |---|---|
//! | `server` | the address, and what stands before and behind every answer |
//! | `guard` | who may ask |
//! | `state` | what all answers share |
//! | `api` | the answers |
//! | `assets` | the files of the page |
//! | `runs`, `listed` | which runs there are, and how far each is |
//! | `kept` | what was read of runs, until their files change |
//! | `curves` | what a run's log has of its updates |
//! | `details` | what a run is |
//! | `seeds` | which runs are seeds of one curve |
//! | `published` | the end of the authors' curve of its method |
//! | `collections` | the log, demonstrations, evaluations |
//! | `episodes` | what each episode came to, and where it lies |
//! | `shown` | an episode, what the reward model says of it, its scene |
//! | `output` | what processes have printed |
//! | `programs` | what others are asked for |
//! | `scenes` | solids as a browser draws them |

mod api;
mod assets;
mod collections;
mod curves;
mod details;
mod episodes;
mod guard;
mod kept;
mod listed;
mod output;
mod programs;
mod published;
mod runs;
mod scenes;
mod seeds;
mod server;
mod shown;
mod state;

pub use programs::{Processes, Programs, Score};
pub use server::{Server, Settings};
