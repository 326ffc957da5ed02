//! `goalward report`: runs, or the figures of plans, as a page with pictures and as tables.

use std::path::PathBuf;

use anyhow::Result;
use run::folder::RunFolder;

use crate::experiment::figure_of_plan;
use crate::print::print_line;
use crate::refusal::wrong_usage;
use crate::{destination, report};

/// Flags of `goalward report`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Folders of runs, and plans, which end in .toml.
    #[arg(required = true, value_name = "RUN|PLAN.toml")]
    what: Vec<PathBuf>,
    /// Folder of the report.
    #[arg(long, value_name = "DIR", default_value = "report")]
    out: PathBuf,
    /// Replaces the files of a report that is there; never anything of a run.
    #[arg(long)]
    force: bool,
    /// Takes the plans at the reduced size of their table `quick`.
    #[arg(long)]
    quick: bool,
    /// Folder of the plans' runs, as given to `goalward experiment --out`.
    #[arg(long, value_name = "DIR", default_value = "experiments")]
    experiments: PathBuf,
}

/// Writes a report.
pub(crate) fn run(arguments: Arguments) -> Result<()> {
    let Arguments { what, out, force, quick, experiments } = arguments;
    let is_plan = |path: &PathBuf| path.extension().is_some_and(|ending| ending == "toml");
    let (plans, folders): (Vec<_>, Vec<_>) = what.into_iter().partition(is_plan);
    if quick && plans.is_empty() {
        return Err(wrong_usage("--quick: expected a plan, found runs only"));
    }
    destination::folder(&out, force)?;
    let figure = |plan: &PathBuf| figure_of_plan(plan, &experiments, quick);
    let mut figures = plans.iter().map(figure).collect::<Result<Vec<_>>>()?;
    if !folders.is_empty() {
        let folders = folders.into_iter().map(RunFolder::new).collect();
        figures.push(report::figure_of_runs(folders)?);
    }
    let page = report::write(figures, &out)?;
    print_line(&format!("{}", page.display()));
    Ok(())
}
