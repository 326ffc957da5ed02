//! The verbs of `goalward`, one file each.

pub(crate) mod config;
pub(crate) mod demonstrate;
pub(crate) mod demonstrations;
pub(crate) mod evaluate;
pub(crate) mod experiment;
pub(crate) mod export;
pub(crate) mod join;
pub(crate) mod log;
pub(crate) mod methods;
pub(crate) mod page;
pub(crate) mod replay;
pub(crate) mod report;
pub(crate) mod runs;
pub(crate) mod scale;
pub(crate) mod shell;
pub(crate) mod status;
pub(crate) mod stop;
pub(crate) mod task;
pub(crate) mod tasks;
pub(crate) mod train;
