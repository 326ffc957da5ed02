//! Curves of several seeds as one: means and intervals at the same steps.

use crate::statistics::Estimate;

/// Most points of a mean curve.
const POINTS: usize = 100;

/// The mean of curves, each of (x, y) by ascending x, at equally spaced places up to `limit`. At each
/// place it is taken over the curves that have come as far.
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

/// The mean of a curve's values within `reach` of `x`; between two points, where none is as near,
/// that of the line through them.
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
