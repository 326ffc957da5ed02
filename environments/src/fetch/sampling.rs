//! The starting positions of cube and goal (Appendix C and the authors' code).
//!
//! Both are drawn beside the gripper's start, the cube around 0.1 m and the goal around -0.1 m along y, from
//! rectangles given by the ranges of the [`FetchSetting`] and stretched by its noise. Ranges in meters:
//!
//! | ranges | cube x | cube y | goal x | goal y |
//! |---|---|---|---|---|
//! | symmetric, Fetch Pick | ± 0.02 | ± 0.02 | ± 0.05 | ± 0.02 |
//! | symmetric, Fetch Push | ± 0.05 | ± 0.02 | ± 0.05 | ± 0.02 |
//! | one-sided | ± 0.05 | 0 to 0.04 | ± 0.05 | -0.04 to 0 |
//!
//! A coverage keeps some of the 4 x 4 bins of a rectangle: one, two, three or four bins of y for each bin of x. Cube
//! and goal are drawn independently, each from the kept bins of its own rectangle.

use super::{FetchSetting, FetchTask, Ranges};
use protocol::error::within;
use protocol::seed::Stream;
use rand::RngExt;

/// Number of bins along each side of a rectangle.
const BINS: usize = 4;
/// Distance of the centers of both rectangles from the gripper's start along y, meters.
const SIDE: f64 = 0.1;

/// Largest factor of the rectangles: beyond it the cube can start inside the fingers.
const NOISE_MAX: f64 = 3.0;

/// The bins of y that a coverage keeps for each bin of x.
type Kept = [&'static [u8]; BINS];

/// All supported coverages. The bins of y are the first four subsets of their size in lexicographic order.
const COVERAGES: [(f64, Kept); 4] = [
    (0.25, [&[0], &[1], &[2], &[3]]),
    (0.5, [&[0, 1], &[0, 2], &[0, 3], &[1, 2]]),
    (0.75, [&[0, 1, 2], &[0, 1, 3], &[0, 2, 3], &[1, 2, 3]]),
    (1.0, [&[0, 1, 2, 3]; BINS]),
];

/// Draws the positions of cube and goal.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Sampling {
    cube: Rectangle,
    goal: Rectangle,
    kept: Kept,
}

/// Smallest and largest offsets from the gripper's start, meters.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Rectangle {
    x: [f64; 2],
    y: [f64; 2],
}

impl Sampling {
    /// Makes the sampling of a setting.
    ///
    /// # Errors
    /// When the coverage or the noise is not supported.
    pub(super) fn new(
        task: FetchTask,
        setting: &FetchSetting,
    ) -> Result<Sampling, protocol::Error> {
        let &FetchSetting { coverage, noise, ranges, .. } = setting;
        let kept = COVERAGES.iter().find(|(known, _)| *known == coverage).map(|(_, kept)| *kept);
        within("coverage", kept.is_some(), "0.25, 0.5, 0.75 or 1", coverage)?;
        let expected = format!("0 to {NOISE_MAX}");
        within("noise", (0.0..=NOISE_MAX).contains(&noise), &expected, noise)?;
        let (cube_x, cube_y, goal_y) = match (ranges, task) {
            (Ranges::Symmetric, FetchTask::Pick) => (0.02, [-0.02, 0.02], [-0.02, 0.02]),
            (Ranges::Symmetric, _) => (0.05, [-0.02, 0.02], [-0.02, 0.02]),
            (Ranges::OneSided, _) => (0.05, [0.0, 0.04], [-0.04, 0.0]),
        };
        let rectangle =
            |x: f64, y: [f64; 2], side| Rectangle { x: [-x, x], y }.stretched(noise).moved(side);
        Ok(Sampling {
            cube: rectangle(cube_x, cube_y, SIDE),
            goal: rectangle(0.05, goal_y, -SIDE),
            kept: kept.unwrap_or_default(),
        })
    }

    /// Draws the positions of cube and goal, as x and y relative to the gripper's start.
    pub(super) fn draw(&self, stream: &mut Stream) -> ([f32; 2], [f32; 2]) {
        let cube = self.draw_from(&self.cube, stream);
        let goal = self.draw_from(&self.goal, stream);
        (cube, goal)
    }

    fn draw_from(&self, rectangle: &Rectangle, stream: &mut Stream) -> [f32; 2] {
        let column = stream.random_range(0..BINS as u32) as usize;
        let kept = self.kept[column];
        let row = kept[stream.random_range(0..kept.len() as u32) as usize];
        let mut within = |[least, largest]: [f64; 2], bin: f64| {
            let bins = bin + stream.random::<f64>();
            (least + (largest - least) * bins / BINS as f64) as f32
        };
        [within(rectangle.x, column as f64), within(rectangle.y, f64::from(row))]
    }
}

impl Rectangle {
    fn stretched(self, factor: f64) -> Rectangle {
        Rectangle { x: self.x.map(|x| x * factor), y: self.y.map(|y| y * factor) }
    }

    fn moved(self, y: f64) -> Rectangle {
        Rectangle { x: self.x, y: self.y.map(|side| side + y) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::seed::{Purpose, stream};

    #[test]
    fn every_bin_kept_is_drawn_as_often_as_any_other() {
        for (coverage, kept) in COVERAGES {
            let setting = FetchSetting { coverage, noise: 1.75, ..FetchSetting::default() };
            let sampling = Sampling::new(FetchTask::Push, &setting).expect("the paper's coverage");
            let mut stream = stream(1, Purpose::Demonstration, 0, 0);
            let mut counts = [[[0; BINS]; BINS]; 2];
            for _ in 0..16_000 {
                let (cube, goal) = sampling.draw(&mut stream);
                for (index, (place, side)) in [(cube, SIDE), (goal, -SIDE)].into_iter().enumerate()
                {
                    let bin = |offset: f64, half: f64| ((offset + half) / half * 2.0) as usize;
                    let x = bin(f64::from(place[0]), 1.75 * 0.05);
                    let y = bin(f64::from(place[1]) - side, 1.75 * 0.02);
                    counts[index][x][y] += 1;
                }
            }
            for (x, y) in (0..BINS).flat_map(|x| (0..BINS).map(move |y| (x, y))) {
                let expected = if kept[x].contains(&(y as u8)) { 4_000 / kept[x].len() } else { 0 };
                for counts in counts {
                    let found: usize = counts[x][y];
                    let spread = if expected == 0 { 0 } else { 200 };
                    assert!(found.abs_diff(expected) <= spread, "{coverage} {x} {y}: {found}");
                }
            }
        }
    }
}
