//! The picture of `goalward replay --with`: mean returns as recorded and from the other reward, of the episodes that
//! reached the goal and of those that did not, or of all episodes if the task does not tell success.

use std::path::Path;

use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};

use report::chart::{self, Axis, COLORS, Chart, Line, Marker, Style};

/// A number as recorded and from the other reward. The service prints the two without names.
#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
#[serde(from = "[f64; 2]")]
pub(super) struct Pair {
    pub(super) recorded: f64,
    pub(super) now: f64,
}

impl From<[f64; 2]> for Pair {
    fn from([recorded, now]: [f64; 2]) -> Pair {
        Pair { recorded, now }
    }
}

/// Mean returns of consecutive episodes.
#[derive(Debug, Deserialize, Serialize)]
pub(super) struct Point {
    episodes: u64,
    all: Option<Pair>,
    reached: Option<Pair>,
    missed: Option<Pair>,
}

const SIZE: [u32; 2] = [1360, 420];

/// Which number of a pair a curve shows.
type Number = fn(Pair) -> f64;

/// Names, colors and numbers of the curves: blue for recorded, orange for the other reward.
const SERIES: [(&str, usize, Number); 2] =
    [("recorded", 1, |pair| pair.recorded), ("now", 0, |pair| pair.now)];

/// Draws the curves into an SVG file.
///
/// # Errors
/// When the file cannot be written.
pub(super) fn draw(curve: &[Point], file: &Path) -> Result<()> {
    let text = chart::draw(&panels(curve), SIZE)?;
    std::fs::write(file, text).with_context(|| file.display().to_string())
}

fn panels(curve: &[Point]) -> Vec<Chart> {
    let tells_success = |point: &Point| point.reached.is_some() || point.missed.is_some();
    if !curve.iter().any(tells_success) {
        return vec![panel("all episodes", curve, |point| point.all)];
    }
    vec![
        panel("goal reached", curve, |point| point.reached),
        panel("goal missed", curve, |point| point.missed),
    ]
}

fn panel(title: &str, curve: &[Point], side: fn(&Point) -> Option<Pair>) -> Chart {
    let last = curve.last().map_or(1, |point| point.episodes);
    let returns = curve.iter().filter_map(side).flat_map(|pair| [pair.recorded, pair.now]);
    let (low, high) =
        returns.fold((0.0_f64, 0.0_f64), |(low, high), one| (low.min(one), high.max(one)));
    let room = 0.05 * (high - low).max(1e-6);
    let line = |(name, color, number): (&str, usize, Number)| {
        let point = |point: &Point| Some([point.episodes as f64, number(side(point)?)]);
        Line {
            name: name.to_owned(),
            style: Style { color: COLORS[color], marker: Marker::None },
            points: curve.iter().filter_map(point).collect(),
            band: Vec::new(),
            seeds: Vec::new(),
            level: None,
            anchor: None,
        }
    };
    let axis = |label: &str, range| Axis { label: label.to_owned(), range, percent: false };
    Chart {
        title: title.to_owned(),
        x: axis("episodes", [0.0, last as f64]),
        y: axis("mean return", [low - room, high + room]),
        curves: SERIES.into_iter().map(line).collect(),
        marks: Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_panels_have_both_curves() {
        let point = |episodes: u64| Point {
            episodes,
            all: None,
            reached: Some([1.0, 0.5].into()),
            missed: (episodes > 1).then_some([0.25, -0.25].into()),
        };
        let text = chart::draw(&panels(&[1, 2, 3, 4].map(point)), SIZE).unwrap();
        let count = |part: &str| text.matches(part).count();
        assert_eq!((count("goal reached"), count("goal missed")), (1, 1));
        // In each panel, a curve and the sample of its color beside its name.
        assert_eq!((count("#0072B2"), count("#D55E00")), (4, 4), "{text}");
        chart::draw(&panels(&[]), SIZE).unwrap();
        let untold =
            Point { all: Some([1.0, 0.5].into()), reached: None, missed: None, ..point(1) };
        let text = chart::draw(&panels(&[untold]), SIZE).unwrap();
        assert!(text.contains("all episodes") && !text.contains("goal"), "{text}");
    }
}
