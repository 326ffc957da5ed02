//! Learning curves of a panel, and the rows of the table below them (the paper's Figures 3 to 9, 11 and 12).

use run::summary::Summary;

use crate::chart::{Axis, Chart, Line};
use crate::curve::mean;
use crate::measured::{Measured, MeasuredCurve, MeasuredPanel, Point};
use crate::palette::Palette;
use crate::statistics::Estimate;

/// Shares of the environment steps at which the table has success rates.
pub(crate) const SHARES: [f64; 3] = [0.25, 0.5, 1.0];

/// A row of the table, for one curve.
pub(crate) struct Row {
    /// Number of finished runs.
    pub(crate) finished: usize,
    /// Number of runs that the curve is to have.
    pub(crate) wanted: usize,
    /// Success rate in training after [`SHARES`] of the steps, over the runs that have reached them.
    pub(crate) during: [Option<Estimate>; 3],
    /// Success rate of the last 100 training episodes, over the finished runs.
    pub(crate) last: Option<Estimate>,
    /// Success rate in the evaluation, over the finished runs.
    pub(crate) evaluation: Option<Estimate>,
    /// Environment steps per second, mean over the finished runs.
    pub(crate) steps_per_s: Option<f64>,
}

impl Row {
    /// Computes the row of a curve.
    pub(crate) fn of(curve: &MeasuredCurve) -> Row {
        let over = |value: &dyn Fn(&Measured) -> Option<f64>| {
            Estimate::of(&curve.runs.iter().filter_map(value).collect::<Vec<f64>>())
        };
        let acting = |value: fn(&Summary) -> Option<f64>| {
            over(&|run| run.summary.as_ref().filter(|_| run.acts()).and_then(value))
        };
        let unread =
            curve.missing.len() - curve.runs.iter().filter(|run| !run.is_finished()).count();
        Row {
            finished: curve.runs.iter().filter(|run| run.is_finished()).count(),
            wanted: curve.runs.len() + unread,
            during: SHARES.map(|share| over(&|run| success_at(run, share))),
            last: acting(|summary| summary.success_rate),
            evaluation: Estimate::of(&curve.evaluations()),
            steps_per_s: acting(|summary| Some(summary.steps_per_s)).map(|estimate| estimate.mean),
        }
    }
}

/// Returns the success rate of the last 100 training episodes after a share of the steps; `None` if the run has not
/// taken as many steps, or its task does not tell success.
fn success_at(run: &Measured, share: f64) -> Option<f64> {
    let steps = share * run.config.steps as f64;
    let tells = run.acts() && run.config.task.tells_success;
    let reached = |point: &&Point| tells && point.environment_steps as f64 >= steps;
    run.points.iter().find(reached).map(|point| point.success_rate)
}

/// The x axis of a chart of success.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Against {
    /// Environment steps.
    Steps,
    /// Wall time.
    Time,
}

/// Returns the chart of a panel's curves: success rates as means over seeds with their 95 % intervals, and the end of
/// each seed. If the task does not tell success, it shows the mean proximity of the batches instead.
pub(crate) fn chart(panel: &MeasuredPanel, palette: &Palette, against: Against) -> Chart {
    let x = |point: &Point| match against {
        Against::Steps => point.environment_steps as f64,
        Against::Time => point.wall_s,
    };
    let runs = || panel.curves.iter().flat_map(|curve| &curve.runs);
    let ends = runs().filter_map(|run| Some(x(run.points.last()?)));
    let end = ends.fold(1.0, f64::max);
    let (unit, label) = match against {
        Against::Steps => steps_unit(end),
        Against::Time => time_unit(end),
    };
    let tells_success = panel.task.tells_success;
    let y = |point: &Point| if tells_success { point.success_rate } else { point.mean_proximity };
    let line = |curve: &MeasuredCurve| {
        let acting = || curve.runs.iter().filter(|run| run.acts());
        let known = |point: &&Point| y(point).is_finite();
        let place = |point: &Point| [x(point) / unit, y(point)];
        let points = |run: &Measured| run.points.iter().filter(known).map(place).collect();
        let means = mean(&acting().map(points).collect::<Vec<_>>(), common_end(curve, &x) / unit);
        let band =
            |(x, estimate): &(f64, Estimate)| estimate.share().map(|[low, high]| [*x, low, high]);
        Line {
            name: curve.name.clone(),
            style: palette.style(&curve.name),
            points: means.iter().map(|(x, estimate)| [*x, estimate.mean]).collect(),
            band: means.iter().filter_map(band).collect(),
            seeds: acting().filter_map(|run| run.points.iter().rfind(known)).map(place).collect(),
            level: level(curve),
            anchor: curve.anchor.filter(|_| tells_success && against == Against::Steps),
        }
    };
    Chart {
        title: panel.title.clone(),
        x: Axis { label: label.to_owned(), range: [0.0, end / unit], percent: false },
        y: match tells_success {
            true => Axis { label: "success".to_owned(), range: [0.0, 1.0], percent: true },
            false => Axis { label: "proximity".to_owned(), range: [0.0, 1.0], percent: false },
        },
        curves: panel.curves.iter().map(line).collect(),
        marks: Vec::new(),
    }
}

/// Returns the x at which the first of a curve's finished runs ends. Beyond it, the mean would be over the longer runs
/// only.
fn common_end(curve: &MeasuredCurve, x: &dyn Fn(&Point) -> f64) -> f64 {
    let finished = curve.runs.iter().filter(|run| run.is_finished());
    let ends = finished.filter_map(|run| Some(x(run.points.last()?)));
    ends.fold(f64::INFINITY, f64::min)
}

/// Returns the success rate in the evaluation of a method that takes no environment steps; `None` for other methods.
fn level(curve: &MeasuredCurve) -> Option<f64> {
    if curve.runs.iter().any(Measured::acts) {
        return None;
    }
    Row::of(curve).evaluation.map(|estimate| estimate.mean)
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

#[cfg(test)]
mod tests {
    use run::folder::RunFolder;
    use run::summary::Summary;

    use super::*;
    use run::tasks;

    /// Returns a run configured for 1,000 steps with `points` as its steps and success rates.
    fn run(points: &[(u64, f64)], evaluation: Option<f64>) -> Measured {
        let steps = ["steps=1000".to_owned()];
        let config = tasks::configuration("navigation", None, &steps).unwrap();
        let summary = |evaluation: f64| -> Summary {
            let steps = points.last().unwrap().0;
            serde_json::from_value(serde_json::json!({
                "task": "navigation", "method": "goal-proximity", "preset": "goalward", "seed": 1,
                "actors": 2, "environment_steps": steps, "episodes": 10, "iterations": points.len(),
                "success_rate": points.last().unwrap().1,
                "evaluation": {"episodes": 50, "success_rate": evaluation},
                "wall_s": 2.0, "steps_per_s": steps / 2, "policy_sha256": "ab",
                "reward_model_sha256": "cd", "log": {"files": 2, "trajectories": 9, "bytes": 9},
                "seconds": {"rollout": 1, "environment": 1, "inference": 1, "transport": 1,
                    "log": 1, "scoring": 1, "policy_update": 1, "reward_update": 1}
            }))
            .unwrap()
        };
        let point = |&(environment_steps, success_rate): &(u64, f64)| Point {
            environment_steps,
            success_rate,
            ..Point::default()
        };
        Measured {
            folder: RunFolder::new("run"),
            config,
            summary: evaluation.map(summary),
            points: points.iter().map(point).collect(),
            times_to_success: Vec::new(),
        }
    }

    fn curve(runs: Vec<Measured>, missing: &[&str]) -> MeasuredCurve {
        let missing = missing.iter().map(|&text| text.to_owned()).collect();
        MeasuredCurve { name: "curve".to_owned(), anchor: Some(0.5), runs, missing }
    }

    #[test]
    fn a_row_counts_finished_runs_and_averages_those_that_came_as_far() {
        let whole = run(&[(250, 0.25), (500, 0.5), (1010, 1.0)], Some(0.875));
        let half = run(&[(260, 0.75), (520, 1.0)], None);
        let missing = ["half: unfinished, 520 of 1,000 steps", "other: not begun"];
        let row = Row::of(&curve(vec![whole, half], &missing));
        assert_eq!((row.finished, row.wanted), (1, 3));
        let means = row.during.map(|spread| spread.unwrap().mean);
        assert_eq!(means, [0.5, 0.75, 1.0]);
        assert_eq!(row.evaluation.unwrap().mean, 0.875);
        assert_eq!(row.steps_per_s, Some(505.0));
    }

    #[test]
    fn a_method_without_steps_is_a_level() {
        let cloning = curve(vec![run(&[(0, 0.0)], Some(0.625))], &[]);
        let row = Row::of(&cloning);
        assert_eq!((row.during, row.last, row.steps_per_s), ([None; 3], None, None));
        let panel = MeasuredPanel {
            name: "navigation".to_owned(),
            title: "NAVIGATION".to_owned(),
            task: tasks::configuration("navigation", None, &[]).unwrap().task,
            curves: vec![cloning],
        };
        let chart = chart(&panel, &Palette::of(&[vec!["curve"]]), Against::Steps);
        assert_eq!((chart.curves[0].level, chart.curves[0].points.len()), (Some(0.625), 0));
        assert_eq!(chart.curves[0].anchor, Some(0.5));
        crate::chart::draw(&[chart], [720, 400]).unwrap();
    }

    #[test]
    fn where_nothing_tells_success_no_published_one_is_drawn() {
        let mut task = tasks::configuration("navigation", None, &[]).unwrap().task;
        task.tells_success = false;
        let panel = MeasuredPanel {
            name: "navigation".to_owned(),
            title: "NAVIGATION".to_owned(),
            task,
            curves: vec![curve(vec![run(&[(500, f64::NAN), (1000, f64::NAN)], None)], &[])],
        };
        let chart = chart(&panel, &Palette::of(&[vec!["curve"]]), Against::Steps);
        assert_eq!((chart.y.label.as_str(), chart.curves[0].anchor), ("proximity", None));
    }
}
