//! Proximity and uncertainty along an evaluation episode, with pictures of four of its states (the paper's Figure 10).

use anyhow::{Result, ensure};
use maud::{Markup, PreEscaped, html};
use protocol::task::{ObservationSpec, Task};
use protocol::trajectory::Trajectory;
use run::config::RunConfig;
use run::folder::RunFolder;

use crate::chart::{self, Axis, COLORS, Chart, Line, Marker, Style, UNITS};
use crate::estimate::{self, Episode};
use crate::programs::{Estimates, ReportPrograms};
use crate::solid::{Camera, Solid};
use crate::{grid, scene};
use terminal::numbers;

/// Number of frames shown.
const FRAMES: usize = 4;

/// Width of the picture, pixels.
const WIDTH: usize = 960;

/// Gap between frames, pixels.
const GAP: usize = 12;

/// Height of a frame, three quarters of its width, pixels.
const FRAME_HEIGHT: usize = (WIDTH - (FRAMES - 1) * GAP) / FRAMES * 3 / 4;

/// Height of the text below a frame, pixels.
const TEXT_HEIGHT: usize = 26;

/// Height of the chart, pixels.
const CHART_HEIGHT: usize = 260;

/// A picture of an episode and what it shows.
pub(crate) struct Along {
    /// The picture, an SVG file.
    pub(crate) picture: String,
    /// A description of what it shows.
    pub(crate) caption: String,
}

/// Draws the successful evaluation episode of median length of a run, or the first episode if none was successful.
///
/// # Errors
/// When there is no episode, or the run's model gives no estimates.
pub(crate) fn along(
    folder: &RunFolder,
    config: &RunConfig,
    programs: &dyn ReportPrograms,
) -> Result<Along> {
    let mut episodes = estimate::episodes(folder, config, programs)?;
    ensure!(!episodes.is_empty(), "{}: expected an evaluation episode", folder.path().display());
    episodes.sort_by_key(|episode| episode.trajectory.steps_to_goal);
    let failed = episodes.iter().filter(|episode| !episode.trajectory.success).count();
    let chosen = if failed == episodes.len() { 0 } else { (failed + episodes.len()) / 2 };
    let episode = episodes.swap_remove(chosen);
    let observations = episode.trajectory.observations_to_goal();
    let estimates = programs.estimate(folder, observations)?;
    let steps = estimates.proximity.len() - 1;
    let end = end(&config.task, &episode.trajectory);
    let caption = format!(
        "an evaluation episode of {steps} steps{end}; lane {}, episode {}, policy version {}",
        episode.trajectory.lane, episode.trajectory.episode, episode.trajectory.policy_version
    );
    Ok(Along { picture: picture(&config.task, &episode, &estimates)?.into_string(), caption })
}

/// Returns whether an episode reached the goal, in words; none if its task does not tell success.
fn end(task: &Task, trajectory: &Trajectory) -> &'static str {
    match (task.tells_success, trajectory.success) {
        (false, _) => "",
        (true, true) => ", which reached the goal",
        (true, false) => ", which missed the goal",
    }
}

fn picture(task: &Task, episode: &Episode, estimates: &Estimates) -> Result<Markup> {
    let last = estimates.proximity.len() - 1;
    let shown: Vec<usize> = (0..FRAMES).map(|frame| frame * last / (FRAMES - 1)).collect();
    let frames = frames(task, episode, &shown);
    let chart =
        chart::draw(&[curves(estimates, &shown)], [WIDTH, CHART_HEIGHT].map(|side| side as u32))?;
    let width = (WIDTH - (FRAMES - 1) * GAP) / FRAMES;
    let chart_top = FRAME_HEIGHT + TEXT_HEIGHT;
    let height = chart_top + CHART_HEIGHT;
    let [chart_width, chart_height] = [WIDTH, CHART_HEIGHT].map(|side| side * UNITS as usize);
    let said = |step: usize| {
        format!("step {step}: proximity {}", numbers::number(estimates.proximity[step]))
    };
    Ok(html! {
        svg xmlns="http://www.w3.org/2000/svg" width=(WIDTH) height=(height)
            viewBox=(format!("0 0 {WIDTH} {height}")) font-family="sans-serif" {
            rect width=(WIDTH) height=(height) fill="#FFFFFF" {}
            @for (number, (frame, step)) in frames.iter().zip(&shown).enumerate() {
                @let left = number * (width + GAP);
                svg x=(left) y="0" width=(width) height=(FRAME_HEIGHT) { (frame) }
                text x=(left + width / 2) y=(FRAME_HEIGHT + 18) font-size="14" fill="#000000"
                    text-anchor="middle" { (said(*step)) }
            }
            svg x="0" y=(chart_top) width=(WIDTH) height=(CHART_HEIGHT)
                viewBox=(format!("0 0 {chart_width} {chart_height}")) { (PreEscaped(chart)) }
        }
    })
}

fn curves(estimates: &Estimates, marks: &[usize]) -> Chart {
    let curve = |name: &str, numbers: &[f64], color: usize| Line {
        name: name.to_owned(),
        style: Style { color: COLORS[color], marker: Marker::None },
        points: numbers.iter().enumerate().map(|(step, y)| [step as f64, *y]).collect(),
        band: Vec::new(),
        seeds: Vec::new(),
        level: None,
        anchor: None,
    };
    let all = || estimates.proximity.iter().chain(&estimates.uncertainty).copied();
    let (low, high) = (all().fold(0.0, f64::min), all().fold(1e-3, f64::max));
    let axis = |label: &str, range| Axis { label: label.to_owned(), range, percent: false };
    Chart {
        title: String::new(),
        x: axis("step", [0.0, (estimates.proximity.len() - 1).max(1) as f64]),
        y: axis("", [1.05 * low, 1.05 * high]),
        curves: vec![
            curve("proximity", &estimates.proximity, 0),
            curve("uncertainty", &estimates.uncertainty, 1),
        ],
        marks: marks.iter().map(|&step| step as f64).collect(),
    }
}

/// Draws an episode at some of its observations.
fn frames(task: &Task, episode: &Episode, shown: &[usize]) -> Vec<Markup> {
    if let ObservationSpec::Cells { width, .. } = task.observation {
        let bytes = task.observation.bytes();
        let observations: Vec<&[u8]> =
            episode.trajectory.observations().chunks_exact(bytes).collect();
        let frame = |&step: &usize| grid::frame(observations[step], width, &task.labels);
        return shown.iter().map(frame).collect();
    }
    let scenes: Vec<Vec<Solid>> =
        shown.iter().filter_map(|&step| Some(Solid::all(episode.scenes.get(step)?))).collect();
    let camera = Camera::looking_from(-50.0, 28.0);
    let view = scene::view(&camera, &scenes);
    scenes.iter().map(|solids| scene::picture(&camera, solids, view)).collect()
}

#[cfg(test)]
mod tests {
    use run::tasks;

    use super::*;

    #[test]
    fn an_end_is_claimed_only_where_the_task_tells_success() {
        let mut task = tasks::configuration("navigation", None, &[]).unwrap().task;
        let said = |task: &Task, success| {
            let trajectory = Trajectory { success, ..Trajectory::default() };
            end(task, &trajectory)
        };
        assert_eq!(said(&task, true), ", which reached the goal");
        assert_eq!(said(&task, false), ", which missed the goal");
        task.tells_success = false;
        assert_eq!(said(&task, false), "");
    }
}
