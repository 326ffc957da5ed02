//! The picture of `goalward replay --with`: mean returns as they were recorded and as they would have
//! been, of the episodes that reached the goal and of those that did not.

use std::path::Path;

use anyhow::{Context, Result, anyhow};
use plotters::coord::Shift;
use plotters::prelude::*;
use serde::Deserialize;

/// Mean returns of some episodes that followed one another; of two numbers the first is recorded.
#[derive(Debug, Deserialize)]
pub(super) struct Point {
    episodes: u64,
    reached: Option<[f64; 2]>,
    missed: Option<[f64; 2]>,
}

const SIZE: (u32, u32) = (960, 420);

/// Blue as recorded, orange as it would have been: apart for every kind of colour sight.
const SERIES: [(&str, RGBColor); 2] =
    [("recorded", RGBColor(0, 114, 178)), ("now", RGBColor(213, 94, 0))];

/// Draws the curves into an SVG file.
///
/// # Errors
/// When the file cannot be written.
pub(super) fn draw(curve: &[Point], file: &Path) -> Result<()> {
    let mut text = String::new();
    paint(curve, &mut text).map_err(|error| anyhow!("{error}")).context("drawing the curves")?;
    std::fs::write(file, text).with_context(|| file.display().to_string())
}

type Painted = Result<(), Box<dyn std::error::Error>>;
type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

fn paint(curve: &[Point], text: &mut String) -> Painted {
    let root = SVGBackend::with_string(text, SIZE).into_drawing_area();
    root.fill(&WHITE)?;
    let halves = root.split_evenly((1, 2));
    panel(&halves[0], "goal reached", curve, |point| point.reached)?;
    panel(&halves[1], "goal missed", curve, |point| point.missed)?;
    Ok(root.present()?)
}

fn panel(
    area: &Area<'_>,
    title: &str,
    curve: &[Point],
    side: fn(&Point) -> Option<[f64; 2]>,
) -> Painted {
    let last = curve.last().map_or(1, |point| point.episodes);
    let returns = curve.iter().filter_map(side).flatten();
    let (low, high) =
        returns.fold((0.0_f64, 0.0_f64), |(low, high), one| (low.min(one), high.max(one)));
    let room = 0.05 * (high - low).max(1e-6);
    let mut chart = ChartBuilder::on(area)
        .caption(title, ("sans-serif", 18))
        .margin(12)
        .x_label_area_size(36)
        .y_label_area_size(56)
        .build_cartesian_2d(0..last, low - room..high + room)?;
    chart
        .configure_mesh()
        .x_desc("episodes")
        .y_desc("mean return")
        .light_line_style(WHITE)
        .draw()?;
    for (place, (name, color)) in SERIES.into_iter().enumerate() {
        let points = curve.iter().filter_map(|point| Some((point.episodes, side(point)?[place])));
        let line = LineSeries::new(points, color.stroke_width(2));
        let sample = move |(x, y)| PathElement::new([(x, y), (x + 18, y)], color.stroke_width(2));
        chart.draw_series(line)?.label(name).legend(sample);
    }
    chart
        .configure_series_labels()
        .background_style(WHITE.mix(0.8))
        .position(SeriesLabelPosition::UpperRight)
        .draw()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_panels_have_both_curves() {
        let point = |episodes: u64| Point {
            episodes,
            reached: Some([1.0, 0.5]),
            missed: (episodes > 1).then_some([0.25, -0.25]),
        };
        let mut text = String::new();
        paint(&[1, 2, 3, 4].map(point), &mut text).unwrap();
        let count = |part: &str| text.matches(part).count();
        assert_eq!((count("goal reached"), count("goal missed")), (1, 1));
        // A curve and its sample in the legend, in each panel.
        assert_eq!((count("#0072B2"), count("#D55E00")), (4, 4), "{text}");
        paint(&[], &mut String::new()).unwrap();
    }
}
