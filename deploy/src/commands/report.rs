//! `goalward report`: runs, or the figures of plans, as a page with pictures and as tables.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{Read, Seek};
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, anyhow, ensure};
use report::TensorBoard;
use report::figure::Figure;
use report::programs::{Estimates, ReportPrograms};
use run::folder::RunFolder;
use run::summary::Summary;
use serde::Deserialize;

use crate::experiment::figure_of_plan;
use crate::programs::{self, Program};
use crate::{answer, destination, event_files, named_runs};
use terminal::print::{print_line, print_remark};
use terminal::refusal::wrong_usage;

/// Flags of `goalward report`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Folders of runs, or folders that contain them, such as that of an experiment, and plans, which end in .toml.
    #[arg(required = true, value_name = "RUNS|PLAN.toml")]
    what: Vec<PathBuf>,
    /// Folder of the report.
    #[arg(long, value_name = "DIR", default_value = "report")]
    out: PathBuf,
    /// Overwrites an existing report, but nothing of a run.
    #[arg(long)]
    force: bool,
    /// Takes the plans at the reduced size of their table `quick`.
    #[arg(long)]
    quick: bool,
    /// Folder of the plans' runs, as given to `goalward experiment --out`; by default `experiments`.
    #[arg(long, value_name = "DIR")]
    experiments: Option<PathBuf>,
    /// Also writes the curves of every run for TensorBoard, to DIR/NAME, where NAME is that of the run's folder.
    #[arg(long, value_name = "DIR")]
    tensorboard: Option<PathBuf>,
}

/// Writes a report.
pub(crate) fn run(arguments: Arguments) -> Result<()> {
    let Arguments { what, out, force, quick, experiments, tensorboard } = arguments;
    let is_plan = |path: &PathBuf| path.extension().is_some_and(|ending| ending == "toml");
    let (plans, folders): (Vec<_>, Vec<_>) = what.into_iter().partition(is_plan);
    for (flag, is_given) in [("--quick", quick), ("--experiments", experiments.is_some())] {
        let words = format!("{flag}: expected a plan, found runs only");
        ensure!(!(is_given && plans.is_empty()), wrong_usage(words));
    }
    let experiments = experiments.unwrap_or_else(|| PathBuf::from("experiments"));
    destination::folder(&out, force)?;
    tensorboard.as_deref().map(|folder| destination::folder(folder, true)).transpose()?;
    let figure = |plan: &PathBuf| figure_of_plan(plan, &experiments, quick);
    let mut figures = plans.iter().map(figure).collect::<Result<Vec<_>>>()?;
    if !folders.is_empty() {
        figures.push(report::figure_of_runs(runs_at(&folders)?)?);
    }
    let event_folders = tensorboard.map(|folder| event_folders(&figures, &folder)).transpose()?;
    let page = destination::filled(&[&out], || report::write(&figures, &out, &OfRuns))?;
    event_folders.map_or(Ok(()), write_event_files)?;
    print_line(&format!("{}", page.display()));
    Ok(())
}

/// Returns the runs at some folders. Refuses a folder without runs, and a run that is given twice: it would count as
/// two seeds.
fn runs_at(folders: &[PathBuf]) -> Result<Vec<RunFolder>> {
    let mut seen = BTreeSet::new();
    let mut runs = Vec::new();
    for folder in folders {
        let found = named_runs::at(std::slice::from_ref(folder))?;
        if found.is_empty() {
            return Err(wrong_usage(format!(
                "expected a run, which has config.toml, or a folder of runs or of an experiment, \
                 found none of them in {}",
                folder.display()
            )));
        }
        for run in &found {
            let path = run.path();
            if !seen.insert(path.canonicalize().unwrap_or_else(|_| path.to_owned())) {
                let shown = path.display();
                return Err(wrong_usage(format!("expected each run once, found {shown} again")));
            }
        }
        runs.extend(found);
    }
    Ok(runs)
}

/// Returns the folder of each run's event file within `folder`; several figures may share a run.
fn event_folders(figures: &[Figure], folder: &Path) -> Result<BTreeMap<PathBuf, RunFolder>> {
    let mut folders = BTreeMap::new();
    let curves = figures.iter().flat_map(|figure| &figure.panels).flat_map(|panel| &panel.curves);
    for run in curves.flat_map(|curve| &curve.runs).filter(|run| run.is_run()) {
        let place = event_files::of_run(run, folder)?;
        let same =
            |other: &RunFolder| other.path().canonicalize().ok() == run.path().canonicalize().ok();
        if let Some(other) = folders.get(&place).filter(|other| !same(other)) {
            let [one, other] = [run, other].map(|run| run.path().display());
            return Err(wrong_usage(format!(
                "--tensorboard: expected runs of different names, found {other} and {one}"
            )));
        }
        folders.insert(place, run.clone());
    }
    Ok(folders)
}

fn write_event_files(folders: BTreeMap<PathBuf, RunFolder>) -> Result<()> {
    for (folder, run) in &folders {
        let mut file = TensorBoard::of(run.clone(), folder)?;
        match Summary::of_finished(run, print_remark) {
            Some(summary) => file.end(&summary)?,
            None => file.go_on()?,
        }
    }
    Ok(())
}

/// Asks the programs of the runs themselves.
struct OfRuns;

impl ReportPrograms for OfRuns {
    fn estimate(&self, folder: &RunFolder, observations: &[u8]) -> Result<Estimates> {
        let mut service = Program::ProximityService.command()?;
        service.arg("estimate").arg("--run").arg(folder.path());
        told(&mut service, |service| programs::result_for(service, "asking", observations))
    }

    fn evaluate(&self, folder: &RunFolder, episodes: usize) -> Result<PathBuf> {
        #[derive(Deserialize)]
        struct Evaluation {
            file: PathBuf,
        }
        let mut actor = Program::acting_in(&folder.config()?.task).command()?;
        actor.arg("evaluate").arg("--run").arg(folder.path());
        actor.arg("--episodes").arg(episodes.to_string());
        let evaluation: Evaluation =
            told(&mut actor, |actor| programs::result(actor, "evaluating"))?;
        Ok(evaluation.file)
    }
}

/// Returns what a program answers to `ask`. If it fails, its last words become the error, since the page is read
/// elsewhere.
fn told<T>(program: &mut Command, ask: impl FnOnce(&mut Command) -> Result<T>) -> Result<T> {
    let mut said = tempfile::tempfile().context("a file for what a program says")?;
    program.stderr(said.try_clone().context("a file for what a program says")?);
    ask(program).map_err(|error| {
        let mut words = String::new();
        said.rewind().and_then(|()| said.read_to_string(&mut words)).ok();
        answer::last_words(&words).map_or(error, |why| anyhow!("{why}"))
    })
}
