//! Which runs of a figure are done and which are missing, and how well the finished ones do.

use run::summary::Summary;
use serde::Serialize;

use report::figure::{Curve, Figure};
use terminal::numbers;
use terminal::print::print_remark;

/// The state of a curve of a figure.
#[derive(Debug, Serialize)]
pub(crate) struct CurveStanding {
    figure: String,
    panel: String,
    curve: String,
    runs: usize,
    finished: usize,
    /// Mean success rate of the finished runs.
    success_rate: Option<f64>,
    /// Success rate at the end of the authors' curve.
    authors: Option<f64>,
}

/// Returns the state of the curves of a figure.
pub(crate) fn curves(figure: &Figure) -> Vec<CurveStanding> {
    let of_panel = figure.panels.iter().flat_map(|panel| {
        panel.curves.iter().map(|curve| {
            let rates = success_rates(curve);
            let mean = rates.iter().sum::<f64>() / rates.len() as f64;
            CurveStanding {
                figure: figure.name.clone(),
                panel: panel.name.clone(),
                curve: curve.name.clone(),
                runs: curve.runs.len(),
                finished: rates.len(),
                success_rate: mean.is_finite().then_some(mean),
                authors: curve.anchor,
            }
        })
    });
    of_panel.collect()
}

/// Returns those of `curves` that belong to a figure, as a table below its title.
pub(crate) fn table(figure: &Figure, curves: &[CurveStanding]) -> String {
    let mut rows = vec![["panel", "curve", "seeds", "success", "authors"].map(str::to_owned)];
    let rate = |rate: Option<f64>, digits| numbers::percent(rate.unwrap_or(f64::NAN), digits);
    for curve in curves.iter().filter(|curve| curve.figure == figure.name) {
        rows.push([
            curve.panel.clone(),
            curve.curve.clone(),
            format!("{} of {}", curve.finished, curve.runs),
            rate(curve.success_rate, 1),
            rate(curve.authors, 0),
        ]);
    }
    format!("{}: {}\n{}", figure.name, figure.title, numbers::columns(&rows))
}

/// Returns the success rates of the finished runs.
fn success_rates(curve: &Curve) -> Vec<f64> {
    let finished = curve.runs.iter().filter_map(|run| Summary::of_finished(run, print_remark));
    finished.map(|summary| success(&summary)).collect()
}

/// Returns the success rate of the last training episodes, as in the paper's curves, or of the evaluation if the method
/// has no training episodes.
fn success(summary: &Summary) -> f64 {
    let Summary { episodes, evaluation, success_rate, .. } = summary;
    let rate = if *episodes == 0 { evaluation.success_rate } else { *success_rate };
    rate.unwrap_or(f64::NAN)
}
