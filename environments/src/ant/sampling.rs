//! The starts of episodes: the goal on its half circle and the noise on the starting pose.

use super::AntSetting;
use super::anatomy::State;
use super::observation::Goal;
use protocol::seed::Stream;
use rand::RngExt;
use rapier3d::prelude::{Rotation, Vector};
use std::f32::consts::PI;

/// Distance of every goal from the origin, meters.
pub(super) const GOAL_DISTANCE: f32 = 5.0;
/// Number of sectors, of nine degrees each, into which a coverage divides the half circle.
const BINS: usize = 20;
/// Height of the goal's mark, meters: the height of the authors' flag when it lies on the floor.
const GOAL_HEIGHT: f32 = 0.51;
/// Orientation of the goal's mark, tipped onto its side as in the authors' code. Like theirs it is not a unit
/// quaternion, and noise is added before normalization.
const GOAL_ORIENTATION: Rotation = Rotation::from_xyzw(1.0, 0.0, 0.0, 1.0);
/// Half the width of the noise on every velocity, meters or radians per second.
const VELOCITY_NOISE: f32 = 0.005;

/// Draws starts and goals.
#[derive(Clone, Debug)]
pub(super) struct Sampling {
    /// Half the width of the noise on every coordinate of the ant, meters or radians.
    noise: f32,
    /// Half the width of the noise on height and orientation of the goal's mark.
    mark_noise: f32,
    /// The sectors of the half circle that goals lie in.
    bins: Vec<u8>,
}

impl Sampling {
    pub(super) fn new(setting: &AntSetting) -> Sampling {
        let noise = setting.noise as f32;
        let mark_noise = if setting.mark_noise { noise } else { 0.0 };
        Sampling { noise, mark_noise, bins: bins(setting.coverage) }
    }

    /// Draws the ant's state and the goal of an episode.
    pub(super) fn draw(&self, stream: &mut Stream) -> (State, Goal) {
        let bin = self.bins[stream.random_range(0..self.bins.len() as u32) as usize];
        let angle = (f32::from(bin) + stream.random::<f32>()) * (PI / BINS as f32);
        let toward = Rotation::from_rotation_z(angle) * Vector::X * GOAL_DISTANCE;

        let mut state = State::start();
        let mut noise = |half_width: f32| (2.0 * stream.random::<f32>() - 1.0) * half_width;
        state.position += Vector::from_array([0; 3].map(|_| noise(self.noise)));
        state.orientation = shaken(state.orientation, || noise(self.noise));
        state.angles = state.angles.map(|angle| angle + noise(self.noise));
        let height = GOAL_HEIGHT + noise(self.mark_noise);
        let orientation = shaken(GOAL_ORIENTATION, || noise(self.mark_noise));

        state.velocity = Vector::from_array([0; 3].map(|_| noise(VELOCITY_NOISE)));
        state.angular_velocity = Vector::from_array([0; 3].map(|_| noise(VELOCITY_NOISE)));
        state.rates = [0; 8].map(|_| noise(VELOCITY_NOISE));
        let goal = Goal { position: Vector::new(toward.x, toward.y, height), orientation };
        (state, goal)
    }
}

/// Adds noise to each number of a quaternion and normalizes it.
fn shaken(rotation: Rotation, mut noise: impl FnMut() -> f32) -> Rotation {
    Rotation::from_array(rotation.to_array().map(|number| number + noise())).normalize()
}

/// Returns the sectors that a coverage keeps, spread evenly over the half circle.
///
/// The phase is chosen to give the authors' sectors for their three coverages: 2, 6, 10, 14 and 18 for 0.25, the even
/// ones for 0.5, and all except 2, 6, 10, 14 and 18 for 0.75.
fn bins(coverage: f64) -> Vec<u8> {
    let kept = ((BINS as f64 * coverage).round() as usize).clamp(1, BINS);
    let before = |bin: usize| (2 * bin * kept + kept + BINS / 2) / (2 * BINS);
    (0..BINS).filter(|&bin| before(bin + 1) > before(bin)).map(|bin| bin as u8).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_coverage_keeps_the_authors_bins() {
        assert_eq!(bins(0.25), [2, 6, 10, 14, 18]);
        assert_eq!(bins(0.5), [0, 2, 4, 6, 8, 10, 12, 14, 16, 18]);
        let others: Vec<u8> = (0..20).filter(|bin| ![2, 6, 10, 14, 18].contains(bin)).collect();
        assert_eq!(bins(0.75), others);
        assert_eq!(bins(1.0), (0..20).collect::<Vec<u8>>());
    }

    #[test]
    fn every_coverage_keeps_its_share() {
        for percent in 1..=100 {
            let kept = bins(f64::from(percent) / 100.0).len();
            let share = f64::from(percent) / 5.0;
            assert!(kept >= 1 && (kept as f64 - share).abs() <= 0.81, "{percent} %: {kept} bins");
        }
    }
}
