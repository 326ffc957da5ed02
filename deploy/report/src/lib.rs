//! Results of runs, as a page with pictures and as tables.
//!
//! A report reads logs, summaries and evaluation episodes of runs, and queries trained proximity functions. It changes
//! nothing in a run, except that a missing evaluation is run and its file stays in the run's folder.
//!
//! | module | what it does |
//! |---|---|
//! | `figure` | figures as data: which runs belong to which curve |
//! | `runs` | groups folders of runs into a figure |
//! | `origin` | which runs are seeds of one curve |
//! | `measured` | the data read from a run |
//! | `curve`, `learning`, `palette` | curves over seeds, their charts and tables (Figures 3 to 9, 11, 12) |
//! | `statistics`, `over_panels` | intervals, and which methods are told apart |
//! | `programs` | requests to a run's programs |
//! | `estimate` | evaluation episodes for which the proximity function is queried |
//! | `chart` | charts as SVG |
//! | `grid` | proximity over NAVIGATION's grid (Figure 4d) |
//! | `episode`, `scene`, `solid` | proximity along an episode and pictures of it (Figure 10) |
//! | `pictures` | all pictures of a report |
//! | `page`, `csv` | the files of a report |
//! | `tensorboard`, `event_file` | a run's curves for TensorBoard |

pub mod chart;
mod csv;
mod curve;
mod episode;
mod estimate;
mod event_file;
pub mod figure;
pub mod grid;
mod learning;
mod measured;
pub mod origin;
mod over_panels;
mod page;
mod palette;
mod pictures;
pub mod programs;
mod runs;
mod scene;
mod solid;
mod statistics;
mod tensorboard;

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use run::folder::RunFolder;
use terminal::refusal::wrong_usage;

use crate::figure::Figure;
use crate::measured::{MeasuredCurve, MeasuredFigure};
use crate::origin::apart;
use crate::pictures::Pictures;
use crate::programs::ReportPrograms;
pub use crate::runs::OF_NO_CURVE;
pub use crate::tensorboard::TensorBoard;

/// Groups runs into a figure with a curve for each origin. Runs without a policy update are left out with a remark.
///
/// # Errors
/// A usage error for the first folder that is no run or whose log cannot be read, when no run has a policy update, or
/// when a curve has a seed twice.
pub fn figure_of_runs(folders: Vec<RunFolder>) -> Result<Figure> {
    let figure = apart(runs::figure(folders)?);
    runs::refuse_seed_twice(&figure)?;
    Ok(figure)
}

/// Writes a report on figures into the folder `out`; returns the path of the page.
///
/// # Errors
/// A usage error when two figures have the same name or no run has anything to show. Other errors when a chart cannot
/// be drawn or the files cannot be written.
pub fn write(figures: &[Figure], out: &Path, programs: &dyn ReportPrograms) -> Result<PathBuf> {
    let mut names = BTreeSet::new();
    if let Some(figure) = figures.iter().find(|figure| !names.insert(figure.name.as_str())) {
        return Err(wrong_usage(format!("expected each figure once, found {} twice", figure.name)));
    }
    let measured = |figure: &Figure| figure.map(MeasuredCurve::of);
    let figures: Vec<MeasuredFigure> = figures.iter().map(measured).collect();
    refuse_nothing(&figures)?;
    let pictures = Pictures::of(&figures, programs)?;
    fs::create_dir_all(out).with_context(|| out.display().to_string())?;
    let save = |name: &str, text: &str| -> Result<PathBuf> {
        let file = out.join(name);
        fs::write(&file, text).with_context(|| file.display().to_string())?;
        Ok(file)
    };
    for (name, text) in pictures.files() {
        save(name, text)?;
    }
    save("results.csv", &csv::results(&figures))?;
    save("summary.csv", &csv::summary(&figures))?;
    save("curves.csv", &csv::curves(&figures))?;
    let folder = out.canonicalize().with_context(|| out.display().to_string())?;
    save("index.html", &page::page(&figures, &pictures, &folder).into_string())
}

/// Refuses figures in which no run has policy updates yet.
fn refuse_nothing(figures: &[MeasuredFigure]) -> Result<()> {
    let curves =
        || figures.iter().flat_map(|figure| &figure.panels).flat_map(|panel| &panel.curves);
    if curves().any(|curve| !curve.runs.is_empty()) {
        return Ok(());
    }
    let missing: Vec<&String> = curves().flat_map(|curve| &curve.missing).collect();
    let first = missing.first().map_or("no run is named", |first| first.as_str());
    Err(wrong_usage(format!(
        "nothing to report on: expected runs with policy updates, found {} without, such as {first} \
         (`goalward experiment` trains the runs of a plan; --experiments DIR says where they lie)",
        missing.len()
    )))
}
