//! What a run is: [`config`] says what it does, [`folder`] what lies where, [`mod@demonstrations`] what
//! it learns from, [`checkpoint`] where it goes on from, [`origin`] whether it is still what it began
//! as, [`repeat`] how it is made again, [`summary`] and [`time_to_success`] what came of it, [`overview`] all that in
//! a line, [`updates`] what its log has of its policy and [`loss`] what that has lost, [`hosts`] which other machines take
//! part, [`actors_wanted`] how many actors each is to have, [`process`] what every process of it wears, [`mod@output`]
//! what it has printed, and [`process_stat`] what the system says of it.

pub mod actors_wanted;
pub mod checkpoint;
pub mod config;
pub mod demonstrations;
pub mod diagnostics;
pub mod folder;
pub mod headway;
pub mod hosts;
pub mod learning_rate;
pub mod loss;
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
