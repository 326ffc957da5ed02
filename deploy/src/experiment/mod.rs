//! Experiments: plans of many runs (tasks x methods x settings x seeds), trained until all are finished.
//!
//! | module | what it does |
//! |---|---|
//! | `file` | a plan as it is in its file |
//! | `plan` | a checked plan: figures, panels, curves, and every run's whole configuration |
//! | `planned_run` | one of these runs |
//! | `archive` | the layout of an experiment's folder, which holds each run once |
//! | `builds`, `demonstrations` | check that all runs are by this build, and on the demonstrations that plans name |
//! | `execution` | starts the runs in order, notes how they end, handles Ctrl-C |
//! | `training`, `recorder` | `goalward train` for a run, and before it the expert that records its demonstrations |
//! | `watching` | shows the progress of runs that other processes train |
//! | `estimate` | the time and the core-hours that are left |
//! | `overview` | what is done and what is missing |
//!
//! A run is identified by what decides its result, so two figures that show the same run share it, and a plan that was
//! interrupted, extended or reordered trains only the missing runs.

mod archive;
mod builds;
mod demonstrations;
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
pub(crate) use demonstrations::refuse_other_demonstrations;
pub(crate) use estimate::{Left, left};
pub(crate) use execution::execute;
pub(crate) use overview::{CurveStanding, curves, table};
pub(crate) use plan::{Plan, queue, read_all};
pub(crate) use planned_run::PlannedRun;
pub(crate) use watching::{Watched, watch};

use report::figure::Figure;
use report::origin::apart;

/// Returns the figure of a plan whose runs are in the experiment's folder `out`.
///
/// # Errors
/// When the plan is invalid.
pub(crate) fn figure_of_plan(path: &Path, out: &Path, quick: bool) -> Result<Figure> {
    Ok(figure_of(&Plan::read(path, quick)?, &mut Archive::open(out)))
}

/// Returns the figure of a plan that has been read.
pub(crate) fn figure_of(plan: &Plan, archive: &mut Archive) -> Figure {
    apart(plan.figure(archive))
}
