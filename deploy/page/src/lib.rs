//! The live page: a server that shows runs, their curves and their episodes in a browser.
//!
//! It reads the runs' folders and requests nothing from their processes, so it does not affect the results of a run.
//! All files that a browser loads are compiled into the program.
//!
//! | module | what it does |
//! |---|---|
//! | `server` | the listener, and what every request and response passes through |
//! | `guard` | which requests are admitted |
//! | `token` | the token that requests need |
//! | `state` | state that all request handlers share |
//! | `api` | routes and their responses |
//! | `assets` | the files of the page |
//! | `runs`, `listed` | the list of runs and the progress of each |
//! | `kept` | a cache of what was read from runs, valid until their files change |
//! | `curves` | the updates in a run's log |
//! | `details` | configuration, summary and other facts of a run |
//! | `seeds` | which runs are seeds of one curve |
//! | `published` | the end of the authors' curve of a run's method |
//! | `collections` | a run's log, demonstrations and evaluations |
//! | `episodes` | the result of each episode and its place in the files |
//! | `shown` | an episode, its scores by a reward model, its scene |
//! | `output` | output of processes |
//! | `programs` | requests to a run's programs |
//! | `scenes` | solids in the form that a browser draws |

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
mod token;

pub use programs::{PagePrograms, Processes, Score};
pub use server::{Server, Settings};
