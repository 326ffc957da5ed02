//! What a run is. [`config`] is what it does, [`folder`] where its files are, [`holder`] which process works on
//! them, [`mod@demonstrations`] what it learns from, [`checkpoint`] where it resumes, [`origin`] what it began
//! with, and [`repeat`] the command that repeats it. [`summary`] and [`time_to_success`] are its results,
//! [`overview`] is a run in one line, [`updates`] are the updates in its log, [`lost`] is what the log has lost.
//! [`hosts`] are the other machines that take part, [`actors_wanted`] how many actors each should have,
//! [`process`] is what all its processes have in common, [`mod@output`] what they print, and [`process_stat`]
//! their state.

pub mod actors_wanted;
pub mod checkpoint;
pub mod config;
pub mod demonstrations;
pub mod diagnostics;
pub mod folder;
pub mod headway;
pub mod holder;
pub mod hosts;
pub mod learning_rate;
pub mod lost;
pub mod metadata;
pub mod origin;
pub mod output;
pub mod overview;
pub mod process;
pub mod process_stat;
pub mod repeat;
pub mod summary;
pub mod tasks;
pub mod time_to_success;
pub mod updates;
