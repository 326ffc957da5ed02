//! What of a figure is done, what is missing, and how well the finished runs do.

use run::summary::Summary;

use report::figure::{Curve, Figure};
use terminal::numbers;
use terminal::print::print_remark;

/// The curves of a figure as a table: finished runs, their mean success, the authors' curve.
pub(crate) fn overview(figure: &Figure) -> String {
    let mut rows = vec![["panel", "curve", "seeds", "success", "authors"].map(str::to_owned)];
    for panel in &figure.panels {
        for curve in &panel.curves {
            let [seeds, success] = finished(curve);
            let anchor = numbers::percent(curve.anchor.unwrap_or(f64::NAN), 0);
            rows.push([panel.name.clone(), curve.name.clone(), seeds, success, anchor]);
        }
    }
    format!("{}: {}\n{}", figure.name, figure.title, numbers::columns(&rows))
}

/// How many runs of a curve are finished, and their mean success.
fn finished(curve: &Curve) -> [String; 2] {
    let mut rates = Vec::new();
    for run in &curve.runs {
        rates.extend(Summary::of_finished(run, print_remark).as_ref().map(success));
    }
    let mean = rates.iter().sum::<f64>() / rates.len() as f64;
    [format!("{} of {}", rates.len(), curve.runs.len()), numbers::percent(mean, 1)]
}

/// Of the last training episodes, as in the paper's curves; of the evaluation, where a method has no
/// training episodes.
fn success(summary: &Summary) -> f64 {
    let Summary { episodes, evaluation, success_rate, .. } = summary;
    let rate = if *episodes == 0 { evaluation.success_rate } else { *success_rate };
    rate.unwrap_or(f64::NAN)
}
