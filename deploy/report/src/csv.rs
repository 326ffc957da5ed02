//! The data of a report as CSV files: `results.csv` has every point of every run, `summary.csv` a line for each run,
//! `curves.csv` a line for each curve of a panel.

use std::fmt::Write;

use run::time_to_success::{LEVELS, TimeToSuccess};

use crate::learning::Row;
use crate::measured::{Measured, MeasuredFigure};
use crate::statistics::{Estimate, Standing};

/// The separators of the fields that are empty for an unfinished run.
const UNFINISHED: &str = ",,,,,,,,,,,";

/// Why writing to a string cannot fail.
const WRITES: &str = "a text takes what is written to it";

/// Columns that identify the run of a line.
const RUN: &str = "figure,panel,task,curve,seed,run";

/// Returns all points of all runs. A quantity that a method does not have is empty.
pub(crate) fn results(figures: &[MeasuredFigure]) -> String {
    let mut text = format!(
        "{RUN},iteration,environment_steps,wall_s,episodes,success_rate,mean_reward,mean_proximity,\
         mean_uncertainty,entropy,approximate_kl\n"
    );
    for (run, names) in named(figures) {
        for point in &run.points {
            write_line(
                &mut text,
                format_args!(
                    "{names},{},{},{:.1},{},{},{},{},{},{},{}",
                    point.iteration,
                    point.environment_steps,
                    point.wall_s,
                    point.episodes,
                    known(point.success_rate, 2),
                    known(point.mean_reward, 6),
                    known(point.mean_proximity, 6),
                    known(point.mean_uncertainty, 6),
                    known(point.entropy, 4),
                    known(point.approximate_kl, 6),
                ),
            );
        }
    }
    text
}

/// Returns the results of all runs. For an unfinished run, those from its summary are empty.
pub(crate) fn summary(figures: &[MeasuredFigure]) -> String {
    let mut text = format!(
        "{RUN},method,preset,finished,environment_steps,episodes,iterations,success_rate,\
         evaluation_episodes,evaluation_success_rate,wall_s,processor_s,steps_per_s,policy_sha256,\
         reward_model_sha256"
    );
    for level in LEVELS {
        let percent = level * 100.0;
        for column in ["environment_steps", "wall_s", "processor_s"] {
            write!(text, ",{column}_to_{percent}").expect(WRITES);
        }
    }
    text.push('\n');
    for (run, names) in named(figures) {
        let method = field(&run.config.method);
        let preset = field(&run.config.preset);
        let Some(summary) = &run.summary else {
            let times = times_to_success(run);
            write_line(&mut text, format_args!("{names},{method},{preset},0{UNFINISHED}{times}"));
            continue;
        };
        // A method that takes no environment steps has no training episodes.
        let success = summary.success_rate.filter(|_| run.acts());
        let success = success.map_or(String::new(), |rate| format!("{rate:.2}"));
        let evaluated = summary.evaluation.success_rate;
        let evaluated = evaluated.map_or(String::new(), |rate| format!("{rate:.4}"));
        write_line(
            &mut text,
            format_args!(
                "{names},{method},{preset},1,{},{},{},{success},{},{evaluated},{:.1},{:.1},{:.0},{},{}{}",
                summary.environment_steps,
                summary.episodes,
                summary.iterations,
                summary.evaluation.episodes,
                summary.wall_s,
                summary.processor_s,
                summary.steps_per_s,
                summary.policy_sha256,
                summary.reward_model_sha256,
                times_to_success(run),
            ),
        );
    }
    text
}

/// Returns the success rates of all curves, means over seeds with their 95 % intervals, and in words how each curve
/// compares with the first of its panel.
pub(crate) fn curves(figures: &[MeasuredFigure]) -> String {
    let mut text = "figure,panel,task,curve,seeds,of_seeds,success_rate,success_rate_low,\
                    success_rate_high,evaluation,evaluation_low,evaluation_high,\
                    against_the_first,authors\n"
        .to_owned();
    for figure in figures {
        for panel in &figure.panels {
            for curve in &panel.curves {
                let names = [&*figure.name, &panel.name, &panel.task.name, &curve.name];
                let [figure, panel_name, task, name] = names.map(field);
                let Row { finished, wanted, last, evaluation, .. } = Row::of(curve);
                let [last, evaluation] = [last, evaluation].map(estimate);
                let standing = curve.standing(&panel.curves[0]).map_or("", Standing::name);
                let anchor = curve.anchor.map_or(String::new(), |rate| rate.to_string());
                write_line(
                    &mut text,
                    format_args!(
                        "{figure},{panel_name},{task},{name},{finished},{wanted},{last},\
                         {evaluation},{standing},{anchor}"
                    ),
                );
            }
        }
    }
    text
}

/// Formats a mean and the ends of its interval; missing ones are empty.
fn estimate(estimate: Option<Estimate>) -> String {
    let Some(estimate) = estimate else { return ",,".to_owned() };
    match estimate.share() {
        Some([low, high]) => format!("{:.4},{low:.4},{high:.4}", estimate.mean),
        None => format!("{:.4},,", estimate.mean),
    }
}

/// Formats the fields of each level of success; empty for levels that were not reached.
fn times_to_success(run: &Measured) -> String {
    let fields = |time: Option<&TimeToSuccess>| match time {
        Some(time) => {
            format!(",{},{:.1},{:.1}", time.environment_steps, time.wall_s, time.processor_s)
        }
        None => ",,,".to_owned(),
    };
    TimeToSuccess::by_level(&run.times_to_success).map(fields).concat()
}

/// Returns every run with its fields for the columns [`RUN`].
fn named(figures: &[MeasuredFigure]) -> impl Iterator<Item = (&Measured, String)> {
    figures.iter().flat_map(|figure| {
        figure.panels.iter().flat_map(move |panel| {
            panel.curves.iter().flat_map(move |curve| {
                curve.runs.iter().map(move |run| {
                    let names = [&*figure.name, &panel.name, &panel.task.name, &curve.name];
                    let [figure, panel, task, curve] = names.map(field);
                    let path = field(&run.folder.path().display().to_string());
                    let seed = run.config.seed;
                    (run, format!("{figure},{panel},{task},{curve},{seed},{path}"))
                })
            })
        })
    })
}

fn write_line(text: &mut String, line: std::fmt::Arguments<'_>) {
    writeln!(text, "{line}").expect(WRITES);
}

/// Formats a number; NaN is an empty field.
fn known(number: f64, decimals: usize) -> String {
    if number.is_nan() { String::new() } else { format!("{number:.decimals$}") }
}

/// Formats a text as a CSV field, quoted if needed.
fn field(text: &str) -> String {
    if text.contains([',', '"', '\n']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_with_commas_are_quoted() {
        assert_eq!(field("gail, a=\"b\""), "\"gail, a=\"\"b\"\"\"");
        assert_eq!(field("gail"), "gail");
    }

    #[test]
    fn lines_have_as_many_fields_as_the_header() {
        let header = summary(&[]);
        let of_run = RUN.matches(',').count() + ",method,preset,finished".matches(',').count();
        let fields = of_run + UNFINISHED.len() + 3 * LEVELS.len();
        assert_eq!(header.matches(',').count(), fields);
    }

    #[test]
    fn the_runs_of_the_results_have_the_columns_of_a_report() {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/results/runs.csv");
        let runs = std::fs::read_to_string(file).unwrap();
        assert_eq!(runs.lines().next(), summary(&[]).lines().next());
    }
}
