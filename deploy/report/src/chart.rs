//! Charts drawn as SVG by plotters: curves with bands, labeled at their ends.
//!
//! Charts use black as foreground and white as background; a page that embeds a chart may replace both.

use anyhow::{Result, anyhow};
use plotters::coord::Shift;
use plotters::coord::types::RangedCoordf64;
use plotters::element::DynElement;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

/// Colors that are distinguishable for people with color vision deficiency (Okabe and Ito).
pub const COLORS: [RGBColor; 7] = [
    RGBColor(213, 94, 0),
    RGBColor(0, 114, 178),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(110, 110, 110),
];

/// Units of the drawing per pixel. Plotters places points at whole units.
pub const UNITS: u32 = 2;

/// The same number, for coordinates.
const UNIT: i32 = UNITS as i32;

/// Width reserved for the names of curves, units.
const NAMES_WIDTH: i32 = 210 * UNIT;

/// The part of this width that the text may take, pixels.
const TEXT_WIDTH: u32 = 166;

/// Height reserved for the name of a curve, units.
const NAME_HEIGHT: i32 = 17 * UNIT;

/// Maximum number of markers on a curve.
const MARKERS: usize = 8;

/// The content of a chart.
pub struct Chart {
    /// Its caption; an empty one is not drawn.
    pub title: String,
    /// The horizontal axis.
    pub x: Axis,
    /// The vertical axis.
    pub y: Axis,
    /// Its curves.
    pub curves: Vec<Line>,
    /// Values of x that are marked by a vertical line.
    pub marks: Vec<f64>,
}

/// An axis.
pub struct Axis {
    /// Its label.
    pub label: String,
    /// Its ends.
    pub range: [f64; 2],
    /// Whether its numbers are shares, to be written in percent.
    pub percent: bool,
}

/// A curve, or a level if it has no points.
pub struct Line {
    /// Its name.
    pub name: String,
    /// Its color and marker.
    pub style: Style,
    /// Its points (x, y), in ascending order of x.
    pub points: Vec<[f64; 2]>,
    /// A band around the curve: x, lower end, upper end.
    pub band: Vec<[f64; 3]>,
    /// The last point of each of its seeds.
    pub seeds: Vec<[f64; 2]>,
    /// Height of a dashed line over the whole chart.
    pub level: Option<f64>,
    /// Height of a diamond at the right end.
    pub anchor: Option<f64>,
}

/// Color and marker of a curve.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Style {
    /// Its color.
    pub color: RGBColor,
    /// The marker on some of its points.
    pub marker: Marker,
}

/// A marker on some points of a curve.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Marker {
    /// No marker.
    None,
    /// Filled circles.
    Circle,
    /// Filled triangles.
    Triangle,
    /// Crosses.
    Cross,
}

impl Marker {
    /// All markers, the plainest first.
    pub const ALL: [Marker; 4] = [Marker::None, Marker::Circle, Marker::Triangle, Marker::Cross];
}

type Painted = Result<(), Box<dyn std::error::Error>>;
type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Plane<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;
type Place = (i32, i32);

/// Draws charts side by side in `size` pixels altogether; returns the text of an SVG file.
///
/// # Errors
/// When plotters cannot draw.
pub fn draw(charts: &[Chart], size: [u32; 2]) -> Result<String> {
    let mut text = String::new();
    let size = size.map(|pixels| pixels * UNITS);
    paint_all(charts, size, &mut text).map_err(|error| anyhow!("drawing a chart: {error}"))?;
    Ok(text)
}

fn paint_all(charts: &[Chart], [width, height]: [u32; 2], text: &mut String) -> Painted {
    let root = SVGBackend::with_string(text, (width, height)).into_drawing_area();
    root.fill(&WHITE)?;
    for (area, chart) in root.split_evenly((1, charts.len())).iter().zip(charts) {
        paint(area, chart)?;
    }
    Ok(root.present()?)
}

fn paint(area: &Area<'_>, chart: &Chart) -> Painted {
    let [left, right] = chart.x.range;
    let [low, high] = chart.y.range;
    let mut builder = ChartBuilder::on(area);
    builder
        .margin(10 * UNIT)
        .margin_right(NAMES_WIDTH)
        .x_label_area_size(38 * UNIT)
        .y_label_area_size(52 * UNIT);
    if !chart.title.is_empty() {
        let room = (area.dim_in_pixel().0 / UNITS).saturating_sub(NAMES_WIDTH as u32 / UNITS);
        builder.caption(&chart.title, font(letter_size(&chart.title, room).min(17)));
    }
    let mut plane = builder.build_cartesian_2d(left..right, low..high)?;
    plane
        .configure_mesh()
        .x_desc(&chart.x.label)
        .y_desc(&chart.y.label)
        .x_labels(6)
        .y_labels(6)
        .x_label_formatter(&|number| chart.x.written(*number))
        .y_label_formatter(&|number| chart.y.written(*number))
        .label_style(font(13))
        .axis_desc_style(font(13))
        .light_line_style(TRANSPARENT)
        .bold_line_style(BLACK.mix(0.12))
        .axis_style(BLACK.mix(0.6).stroke_width(UNITS))
        .draw()?;
    let gray = BLACK.mix(0.45).stroke_width(UNITS);
    for &mark in &chart.marks {
        plane.draw_series(LineSeries::new([(mark, low), (mark, high)], gray))?;
    }
    for line in &chart.curves {
        band(&mut plane, line)?;
    }
    let screen = area.use_screen_coord();
    // The first curve is drawn last, on top of the others.
    for line in chart.curves.iter().rev() {
        curve(&mut plane, &screen, line, chart.x.range)?;
    }
    names(&plane, &screen, chart)
}

fn font(pixels: u32) -> TextStyle<'static> {
    ("sans-serif", pixels * UNITS).into()
}

fn band(plane: &mut Plane<'_, '_>, line: &Line) -> Painted {
    if line.band.len() < 2 {
        return Ok(());
    }
    let lower = line.band.iter().map(|&[x, low, _]| (x, low));
    let upper = line.band.iter().rev().map(|&[x, _, high]| (x, high));
    let corners: Vec<_> = lower.chain(upper).collect();
    plane.draw_series([Polygon::new(corners, line.style.color.mix(0.16))])?;
    Ok(())
}

fn curve(
    plane: &mut Plane<'_, '_>,
    screen: &Area<'_>,
    line: &Line,
    [left, right]: [f64; 2],
) -> Painted {
    let stroke = line.style.color.stroke_width(2 * UNITS);
    let points: Vec<(f64, f64)> = line.points.iter().map(|&[x, y]| (x, y)).collect();
    if let Some(level) = line.level {
        let ends = [(left, level), (right, level)];
        plane.draw_series(DashedLineSeries::new(ends, 7 * UNITS, 5 * UNITS, stroke))?;
    }
    let every = points.len().div_ceil(MARKERS).max(1);
    for place in points.iter().skip(every / 2).step_by(every) {
        if let Some(element) = marker(plane.backend_coord(place), line.style) {
            screen.draw(&element)?;
        }
    }
    plane.draw_series(LineSeries::new(points, stroke))?;
    for &[x, y] in &line.seeds {
        let place = plane.backend_coord(&(x, y));
        screen.draw(&Circle::new(place, 3 * UNIT, line.style.color.mix(0.6).filled()))?;
    }
    if let Some(anchor) = line.anchor {
        let (x, y) = plane.backend_coord(&(right, anchor));
        let reach = 6 * UNIT;
        let corners = [(x - reach, y), (x, y - reach), (x + reach, y), (x, y + reach)];
        screen.draw(&Polygon::new(corners.to_vec(), WHITE))?;
        let outline = [corners[0], corners[1], corners[2], corners[3], corners[0]];
        screen.draw(&PathElement::new(outline.to_vec(), stroke))?;
    }
    Ok(())
}

fn marker<'a>(
    place: Place,
    Style { color, marker }: Style,
) -> Option<DynElement<'static, SVGBackend<'a>, Place>> {
    let stroke = color.stroke_width(2 * UNITS);
    match marker {
        Marker::None => None,
        Marker::Circle => Some(Circle::new(place, 4 * UNIT, color.filled()).into_dyn()),
        Marker::Triangle => Some(TriangleMarker::new(place, 6 * UNIT, color.filled()).into_dyn()),
        Marker::Cross => Some(Cross::new(place, 4 * UNIT, stroke).into_dyn()),
    }
}

/// Writes each curve's name beside its end, as near to it as the other names allow.
fn names(plane: &Plane<'_, '_>, screen: &Area<'_>, chart: &Chart) -> Painted {
    let [low, high] = chart.y.range;
    let right = chart.x.range[1];
    let (x, top) = plane.backend_coord(&(right, high));
    let (_, bottom) = plane.backend_coord(&(right, low));
    let end = |line: &Line| line.points.last().map(|point| point[1]).or(line.level);
    let wanted: Vec<i32> = chart
        .curves
        .iter()
        .map(|line| plane.backend_coord(&(right, end(line).unwrap_or(low))).1)
        .collect();
    let places = apart(&wanted, NAME_HEIGHT, [top, bottom]);
    for (line, y) in chart.curves.iter().zip(places) {
        let stroke = line.style.color.stroke_width(2 * UNITS);
        let (from, to) = ((x + 12 * UNIT, y), (x + 34 * UNIT, y));
        let sample = [from, to];
        if line.level.is_some() {
            let dashes = DashedLineSeries::new(sample, 7 * UNITS, 5 * UNITS, stroke);
            dashes.into_iter().try_for_each(|dash| screen.draw(&dash))?;
        } else {
            screen.draw(&PathElement::new(sample.to_vec(), stroke))?;
        }
        if let Some(element) = marker((x + 23 * UNIT, y), line.style) {
            screen.draw(&element)?;
        }
        let size = letter_size(&line.name, TEXT_WIDTH).min(13);
        let style = font(size).pos(Pos::new(HPos::Left, VPos::Center));
        screen.draw(&Text::new(line.name.clone(), (x + 40 * UNIT, y), style))?;
    }
    Ok(())
}

/// Returns the font size at which a text fits into a width of `room`, but at least a legible one; all in pixels.
fn letter_size(text: &str, room: u32) -> u32 {
    let letters = text.chars().count().max(1) as u32;
    // A letter is about half as wide as it is high.
    (2 * room / letters).max(9)
}

/// Returns positions near the wanted ones that are at least `gap` apart and, if there is room, within the range.
fn apart(wanted: &[i32], gap: i32, [top, bottom]: [i32; 2]) -> Vec<i32> {
    let mut order: Vec<usize> = (0..wanted.len()).collect();
    order.sort_by_key(|&index| wanted[index]);
    let mut places = wanted.to_vec();
    let mut free = top;
    for &index in &order {
        places[index] = places[index].max(free);
        free = places[index] + gap;
    }
    let mut free = bottom;
    for &index in order.iter().rev() {
        places[index] = places[index].min(free);
        free = places[index] - gap;
    }
    places
}

impl Axis {
    fn written(&self, number: f64) -> String {
        if self.percent {
            return format!("{:.0} %", 100.0 * number);
        }
        let text = format!("{number:.3}");
        let text = text.trim_end_matches('0').trim_end_matches('.');
        if text == "-0" { "0".to_owned() } else { text.to_owned() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_stay_apart_and_inside() {
        assert_eq!(apart(&[50, 10, 11], 10, [0, 100]), [50, 10, 20]);
        assert_eq!(apart(&[100, 99, 100], 10, [0, 100]), [90, 80, 100]);
    }

    #[test]
    fn long_texts_have_smaller_letters() {
        assert_eq!(["goal", "goal-proximity"].map(|text| letter_size(text, 100)), [50, 14]);
        assert_eq!(letter_size(&"long".repeat(80), 100), 9);
    }

    #[test]
    fn numbers_on_an_axis_are_short() {
        let axis = |percent| Axis { label: String::new(), range: [0.0, 1.0], percent };
        assert_eq!([0.25, 1.0].map(|share| axis(true).written(share)), ["25 %", "100 %"]);
        let written = [0.0, -0.0001, 0.30000000000000004, 12.0].map(|x| axis(false).written(x));
        assert_eq!(written, ["0", "0", "0.3", "12"]);
    }
}
