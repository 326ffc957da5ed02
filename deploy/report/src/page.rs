//! The page of a report: one self-contained HTML file that needs no network.

use std::path::{Component, Path, PathBuf};

use maud::{DOCTYPE, Markup, PreEscaped, html};
use run::folder::RunFolder;
use run::repeat;
use run::time_to_success::TimeToSuccess;

use crate::learning::{Against, Row, SHARES};
use crate::measured::{Measured, MeasuredCurve, MeasuredFigure, MeasuredPanel};
use crate::over_panels::{OverPanels, over_panels};
use crate::pictures::{Pictures, plain};
use crate::statistics::{Estimate, Standing};
use terminal::numbers;

/// Number of digits of a hash that are shown.
const HASH_DIGITS: usize = 12;

/// Returns the page. Paths on it are relative to `folder`, where it will be written.
pub(crate) fn page(figures: &[MeasuredFigure], pictures: &Pictures, folder: &Path) -> Markup {
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { "Goalward: report" }
                style { (PreEscaped(include_str!("page.css"))) }
            }
            body {
                h1 { "Goalward: report" }
                (measured(figures))
                @for figure in figures { (self::figure(figure, pictures)) }
                (episodes(pictures))
                (runs(figures, folder))
                (reading())
            }
        }
    }
}

fn all_runs(figures: &[MeasuredFigure]) -> impl Iterator<Item = &Measured> {
    let panels = figures.iter().flat_map(|figure| &figure.panels);
    panels.flat_map(|panel| &panel.curves).flat_map(|curve| &curve.runs)
}

/// Returns the runs of all figures, each once even if several figures show it.
fn different_runs(figures: &[MeasuredFigure]) -> Vec<&Measured> {
    let mut runs: Vec<&Measured> = all_runs(figures).collect();
    runs.sort_by_key(|run| run.folder.path());
    runs.dedup_by_key(|run| run.folder.path());
    runs
}

fn measured(figures: &[MeasuredFigure]) -> Markup {
    let runs = different_runs(figures);
    let finished = runs.iter().filter(|run| run.is_finished()).count();
    let steps = runs.iter().filter_map(|run| Some(run.points.last()?.environment_steps)).sum();
    let wall_s = runs.iter().filter_map(|run| Some(run.points.last()?.wall_s)).sum();
    let cores = std::thread::available_parallelism().map_or(0, usize::from);
    html! {
        dl {
            dt { "figures" } dd { (figures.len()) }
            dt { "runs" } dd { (runs.len()) ", " (finished) " of them finished" }
            dt { "environment steps" } dd { (terminal::numbers::count(steps)) }
            dt { "training time of all runs" } dd { (terminal::numbers::duration(wall_s)) }
            dt { "this report was made on" } dd { (processor()) ", " (cores) " cores" }
            dt { "data" } dd {
                a href="results.csv" { "results.csv" } " (every update), "
                a href="summary.csv" { "summary.csv" } " (every run), "
                a href="curves.csv" { "curves.csv" } " (every curve)"
            }
        }
    }
}

fn processor() -> String {
    let text = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name =
        text.lines().find_map(|line| Some(line.strip_prefix("model name")?.split_once(':')?.1));
    name.unwrap_or("an unknown processor").trim().to_owned()
}

fn figure(figure: &MeasuredFigure, pictures: &Pictures) -> Markup {
    html! {
        section id=(format!("figure-{}", plain(&figure.name))) {
            h2 { (figure.title) }
            div.panels {
                @for panel in &figure.panels {
                    article { (self::panel(figure, panel, pictures)) }
                }
            }
            (all_panels(&over_panels(figure)))
        }
    }
}

fn panel(figure: &MeasuredFigure, panel: &MeasuredPanel, pictures: &Pictures) -> Markup {
    let learning = |against| pictures.learning(&figure.name, &panel.name, against);
    html! {
        @match learning(Against::Steps) {
            Some(text) => { (picture(text, &panel.title, "")) }
            None => { h3 { (panel.title) } p { "No run of this panel exists yet." } }
        }
        (table(panel))
        @if let Some(text) = learning(Against::Time) {
            details {
                summary { "The same against wall time" }
                (picture(text, &panel.title, "Runs that shared the machine with others took longer."))
            }
        }
        @match pictures.heat(&figure.name, &panel.name) {
            Some(Ok((text, caption))) => (picture(text, caption, caption)),
            Some(Err(reason)) => p { "No proximity over the grid: " (reason) },
            None => {}
        }
    }
}

/// Embeds a picture; `title` is its label for screen readers.
fn picture(text: &str, title: &str, caption: &str) -> Markup {
    html! {
        figure {
            div.picture.scroll role="img" aria-label=(title) { (PreEscaped(text)) }
            @if !caption.is_empty() { figcaption { (caption) } }
        }
    }
}

fn table(panel: &MeasuredPanel) -> Markup {
    let anchored = panel.curves.iter().any(|curve| curve.anchor.is_some());
    let missing = panel.curves.iter().any(|curve| !curve.missing.is_empty());
    html! {
        div.scroll {
            table {
                thead {
                    tr {
                        th { "curve" } th { "seeds" }
                        @for share in SHARES { th { "at " (numbers::percent(share, 0)) " of steps" } }
                        th { "last 100" } th { "evaluation" } th.text { "against the first" }
                        @if anchored { th { "authors" } }
                        th { "steps/s" }
                        @if missing { th.text { "missing" } }
                    }
                }
                tbody { @for curve in &panel.curves { (row(curve, &panel.curves[0], anchored, missing)) } }
            }
        }
    }
}

fn row(curve: &MeasuredCurve, first: &MeasuredCurve, anchored: bool, missing: bool) -> Markup {
    let row = Row::of(curve);
    html! {
        tr {
            td { (curve.name) }
            td { (seeds(&row)) }
            @for estimate in &row.during { td { (success(estimate.as_ref())) } }
            td { (success(row.last.as_ref())) }
            td { (success(row.evaluation.as_ref())) }
            td.text { (curve.standing(first).map_or("-", Standing::name)) }
            @if anchored {
                td { (curve.anchor.map_or("-".to_owned(), |share| numbers::percent(share, 0))) }
            }
            td { (row.steps_per_s.map_or("-".to_owned(), |pace| numbers::count(pace as u64))) }
            @if missing { td.wrap { (curve.missing.join("; ")) } }
        }
    }
}

fn seeds(row: &Row) -> String {
    let Row { finished, wanted, .. } = row;
    if finished == wanted { finished.to_string() } else { format!("{finished} of {wanted}") }
}

/// Formats the mean and, in brackets, the 95 % interval, in percent.
fn success(estimate: Option<&Estimate>) -> String {
    let Some(estimate) = estimate else { return "-".to_owned() };
    match estimate.share() {
        Some(interval) => bounded((estimate.mean, interval)),
        None => format!("{:.1}", 100.0 * estimate.mean),
    }
}

fn bounded((value, [low, high]): (f64, [f64; 2])) -> String {
    format!("{:.1} ({:.1} to {:.1})", 100.0 * value, 100.0 * low, 100.0 * high)
}

/// Returns the table of methods over all panels.
fn all_panels(methods: &[OverPanels]) -> Markup {
    let Some(first) = methods.first() else { return html! {} };
    html! {
        h3 { "Over all panels" }
        div.scroll {
            table {
                thead {
                    tr {
                        th { "method" } th { "runs" } th { "interquartile mean" }
                        th { "better than " (first.name) } th.text { "in words" }
                    }
                }
                tbody {
                    @for method in methods {
                        tr {
                            td { (method.name) }
                            td { (method.runs) }
                            td { (bounded(method.interquartile_mean)) }
                            td { (method.improvement.map_or("-".to_owned(), bounded)) }
                            td.text { (method.standing().map_or("-", Standing::name)) }
                        }
                    }
                }
            }
        }
    }
}

fn episodes(pictures: &Pictures) -> Markup {
    let mut episodes = pictures.episodes().peekable();
    html! {
        @if episodes.peek().is_some() {
            section id="episodes" {
                h2 { "Proximity along an episode" }
                @for episode in episodes {
                    @match episode {
                        Ok((text, caption)) => (picture(text, caption, caption)),
                        Err(reason) => p { "No picture: " (reason) },
                    }
                }
            }
        }
    }
}

fn runs(figures: &[MeasuredFigure], folder: &Path) -> Markup {
    html! {
        section id="runs" {
            h2 { "All runs" }
            div.scroll {
                table {
                    thead {
                        tr {
                            th { "run" } th { "seed" } th { "steps" } th { "last 100" } th { "evaluation" }
                            th { "time" } th { "time to 50, 90, 95, 98 %" }
                            th.text { "policy sha256" } th.text { "to repeat it" }
                        }
                    }
                    tbody { @for run in different_runs(figures) { (run_row(run, folder)) } }
                }
            }
        }
    }
}

fn run_row(run: &Measured, folder: &Path) -> Markup {
    let summary = run.summary.as_ref();
    let last = run.points.last();
    let steps = last.map_or(0, |point| point.environment_steps);
    let percent =
        |share: Option<f64>| share.map_or("-".to_owned(), |share| numbers::percent(share, 1));
    let hash = summary.map(|summary| summary.policy_sha256.chars().take(HASH_DIGITS).collect());
    html! {
        tr {
            td { code { (seen_from(folder, &run.folder).display()) } }
            td { (run.config.seed) }
            td { (numbers::count(steps)) @if summary.is_none() { " so far" } }
            td { (percent(last.filter(|_| run.acts()).map(|point| point.success_rate))) }
            td { (percent(summary.and_then(|summary| summary.evaluation.success_rate))) }
            td { (numbers::duration(summary.map_or(f64::NAN, |summary| summary.wall_s))) }
            td { (times_to_success(run)) }
            td.text { code { (hash.unwrap_or("-".to_owned())) } }
            td.text { code { (repeat::command(&run.folder, &run.config)) } }
        }
    }
}

/// Formats a run's wall time to each level of success.
fn times_to_success(run: &Measured) -> String {
    let duration =
        |time: Option<&TimeToSuccess>| numbers::duration(time.map_or(f64::NAN, |time| time.wall_s));
    TimeToSuccess::by_level(&run.times_to_success).map(duration).join(", ")
}

/// Returns a run's folder relative to `folder`, or as an absolute path if they have only the root in common.
fn seen_from(folder: &Path, run: &RunFolder) -> PathBuf {
    let Ok(path) = run.path().canonicalize() else { return run.path().to_owned() };
    let pairs = folder.components().zip(path.components());
    let common = pairs.take_while(|(one, other)| one == other).count();
    if common < 2 {
        return path;
    }
    let up = folder.components().skip(common).map(|_| Component::ParentDir);
    up.chain(path.components().skip(common)).collect()
}

fn reading() -> Markup {
    html! {
        section id="reading" {
            h2 { "How to read this" }
            ul {
                li { "Success is the share of the last 100 training episodes that reached the goal, actions \
                      drawn from the policy. Curves are means over the seeds that have got that far. Bands \
                      and values in brackets are 95 % intervals of the mean over seeds (Student's; none for \
                      fewer than three seeds). A dot is the end of a seed." }
                li { "Against the first: ahead or behind where the 95 % interval of the difference of the \
                      evaluations' means excludes 0 (Welch's); otherwise every seed above or \
                      below, if that is so; otherwise not told apart." }
                li { "Over all panels: the mean of the middle half of all evaluations, and the share of pairs \
                      of seeds in which a method is better than the first one, with stratified bootstrap \
                      intervals (Agarwal et al., 2021), which are somewhat narrow for few seeds." }
                li { "A dashed level is the evaluation of a method that takes no environment steps." }
                li { "Diamonds, and the column \u{201c}authors\u{201d}, are success rates that the authors \
                      published: the ends of their curves or, for FETCH PICK at 50 % coverage, 80 % for \
                      \u{201c}more than 80 %\u{201d} in the paper's text. Some of their baselines had errors, \
                      so a correct one may score higher." }
                li { "Wall time includes training before the first rollout; pauses of a resumed run are left \
                      out. Steps per second are those of the summaries." }
                li { "The same command gives the same hash, whatever the number of actors." }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_are_named_as_the_page_sees_them() {
        let directory = tempfile::tempdir().unwrap();
        let home = directory.path().canonicalize().unwrap();
        for folder in ["runs/a", "report"] {
            std::fs::create_dir_all(home.join(folder)).unwrap();
        }
        let run = RunFolder::new(home.join("runs/a"));
        assert_eq!(seen_from(&home.join("report"), &run), Path::new("../runs/a"));
    }

    #[test]
    fn shares_are_written_with_their_interval() {
        let estimate = |interval| Estimate { mean: 0.975, interval };
        assert_eq!(success(Some(&estimate(Some([0.9375, 1.0125])))), "97.5 (93.8 to 100.0)");
        assert_eq!(success(Some(&estimate(None))), "97.5");
        assert_eq!(success(None), "-");
    }
}
