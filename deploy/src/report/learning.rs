//! Learning curves of a panel and the table below them (the paper's Figures 3 to 9, 11 and 12).

use super::curve::{Spread, mean};
use super::measured::{Measured, MeasuredCurve, MeasuredPanel, Point};
use super::palette::Palette;
use crate::chart::{Axis, Chart, Line};

/// Shares of the steps at which the table gives success rates.
pub(super) const SHARES: [f64; 3] = [0.25, 0.5, 1.0];

/// A curve in numbers.
pub(super) struct Row {
    /// Finished runs.
    pub(super) finished: usize,
    /// Runs wanted.
    pub(super) wanted: usize,
    /// Success rate in training when [`SHARES`] of the steps were taken, over the runs that have.
    pub(super) during: [Option<Spread>; 3],
    /// Success rate of the last 100 training episodes of the finished runs.
    pub(super) last: Option<Spread>,
    /// Success rate of the evaluation of the finished runs.
    pub(super) evaluation: Option<Spread>,
    /// Environment steps per second, mean of the finished runs.
    pub(super) steps_per_s: Option<f64>,
}

impl Row {
    /// Of a curve.
    pub(super) fn of(curve: &MeasuredCurve) -> Row {
        let over = |value: &dyn Fn(&Measured) -> Option<f64>| {
            Spread::of(&curve.runs.iter().filter_map(value).collect::<Vec<f64>>())
        };
        let acting = |run: &Measured| run.summary.as_ref().filter(|_| run.acts()).cloned();
        let unread =
            curve.missing.len() - curve.runs.iter().filter(|run| !run.is_finished()).count();
        Row {
            finished: curve.runs.iter().filter(|run| run.is_finished()).count(),
            wanted: curve.runs.len() + unread,
            during: SHARES.map(|share| over(&|run| success_at(run, share))),
            last: over(&|run| Some(acting(run)?.success_rate)),
            evaluation: over(&|run| Some(run.summary.as_ref()?.evaluation.success_rate)),
            steps_per_s: over(&|run| Some(acting(run)?.steps_per_s)).map(|spread| spread.mean),
        }
    }
}

/// Success rate of the last 100 training episodes when a share of the steps was taken.
fn success_at(run: &Measured, share: f64) -> Option<f64> {
    let steps = share * run.config.steps as f64;
    let reached = |point: &&Point| run.acts() && point.environment_steps as f64 >= steps;
    run.points.iter().find(reached).map(|point| point.success_rate)
}

/// What success is drawn against.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Against {
    /// Environment steps.
    Steps,
    /// Wall time.
    Time,
}

/// Success rates of a panel's curves, means over seeds with bands of half a standard deviation.
pub(super) fn chart(panel: &MeasuredPanel, palette: &Palette, against: Against) -> Chart {
    let x = |point: &Point| match against {
        Against::Steps => point.environment_steps as f64,
        Against::Time => point.wall_s,
    };
    let runs = || panel.curves.iter().flat_map(|curve| &curve.runs);
    let ends = runs().filter_map(|run| Some(x(run.points.last()?)));
    let end = ends.fold(0.0, f64::max);
    let (unit, label) = match against {
        Against::Steps => steps_unit(end),
        Against::Time => time_unit(end),
    };
    let line = |curve: &MeasuredCurve| {
        let acting = curve.runs.iter().filter(|run| run.acts());
        let points = |run: &Measured| {
            run.points.iter().map(|point| [x(point) / unit, point.success_rate]).collect()
        };
        let means = mean(&acting.map(points).collect::<Vec<_>>());
        let band = |(x, spread): &(f64, Spread)| spread.band().map(|[low, high]| [*x, low, high]);
        Line {
            name: curve.name.clone(),
            style: palette.style(&curve.name),
            points: means.iter().map(|(x, spread)| [*x, spread.mean]).collect(),
            band: means.iter().filter_map(band).collect(),
            level: level(curve),
            anchor: curve.anchor.filter(|_| against == Against::Steps),
        }
    };
    Chart {
        title: panel.title.clone(),
        x: Axis { label: label.to_owned(), range: [0.0, (end / unit).max(1e-9)], percent: false },
        y: Axis { label: "success".to_owned(), range: [0.0, 1.0], percent: true },
        curves: panel.curves.iter().map(line).collect(),
        marks: Vec::new(),
    }
}

/// Success of a method that takes no environment steps, in its evaluation.
fn level(curve: &MeasuredCurve) -> Option<f64> {
    if curve.runs.iter().any(Measured::acts) {
        return None;
    }
    Row::of(curve).evaluation.map(|spread| spread.mean)
}

fn steps_unit(end: f64) -> (f64, &'static str) {
    match end {
        1e6.. => (1e6, "environment steps, millions"),
        _ => (1e3, "environment steps, thousands"),
    }
}

fn time_unit(end_s: f64) -> (f64, &'static str) {
    match end_s {
        10_800.0.. => (3600.0, "wall time, hours"),
        180.0.. => (60.0, "wall time, minutes"),
        _ => (1.0, "wall time, seconds"),
    }
}
