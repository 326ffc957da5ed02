//! Combines the curves of several seeds into one: means and intervals at common steps.

use crate::statistics::Estimate;

/// Maximum number of points of a mean curve.
const POINTS: usize = 100;

/// Returns the mean of curves, each of points (x, y) in ascending order of x, at equally spaced x up to `limit`. At
/// each x, the mean is over the curves that reach it.
pub(crate) fn mean(curves: &[Vec<[f64; 2]>], limit: f64) -> Vec<(f64, Estimate)> {
    let ends = curves.iter().filter_map(|points| Some(points.last()?[0]));
    let end = ends.fold(0.0, f64::max).min(limit);
    let longest = curves.iter().map(Vec::len).max().unwrap_or(0);
    let count = POINTS.min(longest);
    let width = end / count as f64;
    let at = |number: usize| {
        let x = width * number as f64;
        let values: Vec<f64> =
            curves.iter().filter_map(|points| value_near(points, x, width / 2.0)).collect();
        Some((x, Estimate::of(&values)?))
    };
    (1..=count).filter_map(at).collect()
}

/// Returns the mean of a curve's values within `reach` of `x`. If no point is that near, interpolates linearly between
/// the two points around `x`; returns `None` if `x` is not between two points.
fn value_near(points: &[[f64; 2]], x: f64, reach: f64) -> Option<f64> {
    let near = points.iter().filter(|point| (point[0] - x).abs() <= reach);
    let (sum, count) = near.fold((0.0, 0.0), |(sum, count), point| (sum + point[1], count + 1.0));
    if count > 0.0 {
        return Some(sum / count);
    }
    let pair = points.windows(2).find(|pair| pair[0][0] <= x && x <= pair[1][0])?;
    let [[left, low], [right, high]] = [pair[0], pair[1]];
    Some(low + (high - low) * (x - left) / (right - left))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seeds_are_averaged_as_far_as_they_go() {
        let curves =
            [vec![[1.0, 0.0], [2.0, 0.25], [3.0, 0.5], [4.0, 1.0]], vec![[1.0, 0.5], [2.0, 0.75]]];
        let found = mean(&curves, 5.0);
        let means: Vec<_> = found.iter().map(|(x, estimate)| (*x, estimate.mean)).collect();
        assert_eq!(means, [(1.0, 0.25), (2.0, 0.5), (3.0, 0.5), (4.0, 1.0)]);
        assert!(mean(&[], 5.0).is_empty());
        assert_eq!(
            mean(&curves, 2.0).last().map(|(x, estimate)| (*x, estimate.mean)),
            Some((2.0, 0.5))
        );
    }

    #[test]
    fn a_gap_is_bridged_and_an_end_is_not() {
        let points = [[0.0, 0.0], [10.0, 1.0]];
        assert_eq!(value_near(&points, 5.0, 1.0), Some(0.5));
        assert_eq!(value_near(&points, 12.0, 1.0), None);
    }
}
