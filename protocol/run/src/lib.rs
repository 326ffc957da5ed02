//! What a run is: [`config`] says what it does, [`folder`] what lies where, [`mod@demonstrations`] what
//! it learns from, [`checkpoint`] where it goes on from, [`origin`] whether it is still what it began
//! as, [`summary`] what came of it, and [`process`] what every process of it wears.

pub mod checkpoint;
pub mod config;
pub mod demonstrations;
pub mod diagnostics;
pub mod folder;
pub mod headway;
pub mod learning_rate;
pub mod metadata;
pub mod origin;
pub mod process;
pub mod summary;
pub mod tasks;
