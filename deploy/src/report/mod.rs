//! `goalward report`: what runs have come to, as one page with pictures and as tables.
//!
//! It reads logs, summaries and evaluation episodes of runs, and asks trained proximity functions
//! through the proximity service. Nothing of a run is changed; an evaluation that is missing is run
//! and stays in the run's folder.
//!
//! | module | what it does |
//! |---|---|
//! | `runs` | folders of runs to a figure |
//! | `measured` | what a run says |
//! | `curve`, `learning`, `palette` | curves over seeds, their charts and tables (Figures 3 to 9, 11, 12) |
//! | `estimate` | evaluation episodes, and what a proximity function says of observations |
//! | `grid` | proximity over NAVIGATION's grid (Figure 4d) |
//! | `episode`, `scene`, `solid` | proximity along an episode and pictures of it (Figure 10) |
//! | `repeat` | the command that makes a run again |
//! | `pictures` | all pictures of a report |
//! | `page`, `csv` | what is written |

mod csv;
mod curve;
mod episode;
mod estimate;
mod grid;
mod learning;
mod measured;
mod page;
mod palette;
mod pictures;
mod repeat;
mod runs;
mod scene;
mod solid;

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use run::folder::RunFolder;

use self::measured::{MeasuredCurve, MeasuredFigure};
use self::pictures::Pictures;
use crate::figure::Figure;
use crate::origin::apart;
use crate::refusal::wrong_usage;

/// Folders of runs as a figure.
///
/// # Errors
/// Of wrong usage for the first folder that holds no run, no log or no policy update.
pub(crate) fn figure_of_runs(folders: Vec<RunFolder>) -> Result<Figure> {
    Ok(apart(runs::figure(folders)?))
}

/// Writes a report on figures into the folder `out`; gives the page's file.
///
/// # Errors
/// Of wrong usage, when two figures have the same name or no run has anything to show. When the
/// files cannot be written.
pub(crate) fn write(figures: Vec<Figure>, out: &Path) -> Result<PathBuf> {
    let mut names = BTreeSet::new();
    if let Some(figure) = figures.iter().find(|figure| !names.insert(figure.name.as_str())) {
        return Err(wrong_usage(format!("expected each figure once, found {} twice", figure.name)));
    }
    let measured = |figure: Figure| figure.map(MeasuredCurve::of);
    let figures: Vec<MeasuredFigure> = figures.into_iter().map(measured).collect();
    refuse_nothing(&figures)?;
    let pictures = Pictures::of(&figures)?;
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
    let folder = out.canonicalize().with_context(|| out.display().to_string())?;
    save("index.html", &page::page(&figures, &pictures, &folder).into_string())
}

/// Plans whose runs are all to come have no report.
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
