//! Experiments: plans of many runs, tasks x methods x settings x seeds, run to the end of the last.
//!
//! | module | what it does |
//! |---|---|
//! | `file` | a plan as its file has it |
//! | `plan` | a plan, checked: figures, panels, curves, and every run's whole configuration |
//! | `planned_run` | one of these runs |
//! | `archive` | what lies where in an experiment's folder; a run is in it once |
//! | `builds` | that all runs are of the build at work |
//! | `execution` | which run is next, what became of it, Ctrl-C |
//! | `training`, `recorder` | a `goalward train` for a run, and before it an expert for its demonstrations |
//! | `watching` | how it stands while others train |
//! | `estimate` | the time that is left, and the core-hours |
//! | `overview` | what is done and what is missing |
//!
//! A run is known by what decides its result, so two figures that show the same run share it, and a
//! plan that was interrupted, extended or reordered runs only what is missing.

mod archive;
mod builds;
pub(crate) mod estimate;
mod execution;
mod file;
mod overview;
mod plan;
mod planned_run;
mod recorder;
#[cfg(test)]
mod tests;
mod training;
mod watching;

use std::path::Path;

use anyhow::Result;

pub(crate) use archive::Archive;
pub(crate) use builds::refuse_other_builds;
pub(crate) use estimate::{Left, left};
pub(crate) use execution::execute;
pub(crate) use overview::{CurveStanding, curves, table};
pub(crate) use plan::{Plan, queue, read_all};
pub(crate) use planned_run::PlannedRun;
pub(crate) use watching::{Watched, watch};

use report::figure::Figure;
use report::origin::apart;

/// The figure of a plan whose runs lie in the experiment's folder `out`.
///
/// # Errors
/// When the plan is not sound.
pub(crate) fn figure_of_plan(path: &Path, out: &Path, quick: bool) -> Result<Figure> {
    Ok(figure_of(&Plan::read(path, quick)?, &mut Archive::open(out)))
}

/// The same of a plan that has been read.
pub(crate) fn figure_of(plan: &Plan, archive: &mut Archive) -> Figure {
    apart(plan.figure(archive))
}
