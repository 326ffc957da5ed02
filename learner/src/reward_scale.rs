//! Division of rewards by the running standard deviation of the discounted return, between scoring and
//! advantages. This is the authors' setting; it makes their "reward scale" (Table 2) have no effect.

use networks::RunningMoments;

/// Running moments of the discounted return over all lanes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct RewardScale {
    /// Moments of the returns seen.
    pub(crate) returns: RunningMoments,
}

/// The rewards of one episode, and the lane it belongs to.
pub(crate) struct EpisodeRewards<'a> {
    /// Lane of the episode.
    pub(crate) lane: u64,
    /// One reward per step.
    pub(crate) rewards: &'a mut [f32],
}

impl RewardScale {
    /// Scales a batch's rewards in place. Episodes must be sorted by lane. The lanes are traversed side by
    /// side, as if they had been stepped together, and each step's returns enter the moments before that step's
    /// rewards are divided.
    pub(crate) fn apply(&mut self, episodes: &mut [EpisodeRewards<'_>], gamma: f64) {
        let mut lanes = LaneCursor::of(episodes);
        while lanes.iter().any(|lane| lane.next < lane.end) {
            let mut returns = Vec::with_capacity(lanes.len());
            let mut steps = Vec::with_capacity(lanes.len());
            for lane in &mut lanes {
                let Some((episode, step)) = lane.take(episodes) else { continue };
                let reward = f64::from(episodes[episode].rewards[step]);
                lane.discounted = if step == 0 { reward } else { lane.discounted * gamma + reward };
                returns.push(lane.discounted);
                steps.push((episode, step));
            }
            self.include(&returns);
            let scale = self.returns.standard_deviation();
            for (episode, step) in steps {
                let reward = &mut episodes[episode].rewards[step];
                *reward = (f64::from(*reward) / scale) as f32;
            }
        }
    }

    /// Takes in the returns of one step of every lane. The sum of squares is computed from the variance; that
    /// rounding is part of the weights of all recorded runs.
    fn include(&mut self, returns: &[f64]) {
        let count = returns.len() as f64;
        let mean = returns.iter().sum::<f64>() / count;
        let variance = returns.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / count;
        self.returns.merge(count, mean, variance * count);
    }
}

/// A lane's position in its episodes.
struct LaneCursor {
    next: usize,
    end: usize,
    step: usize,
    discounted: f64,
}

impl LaneCursor {
    fn of(episodes: &[EpisodeRewards<'_>]) -> Vec<LaneCursor> {
        let mut lanes: Vec<LaneCursor> = Vec::new();
        for (position, episode) in episodes.iter().enumerate() {
            match lanes.last_mut() {
                Some(lane) if episodes[lane.next].lane == episode.lane => lane.end = position + 1,
                _ => lanes.push(LaneCursor {
                    next: position,
                    end: position + 1,
                    step: 0,
                    discounted: 0.0,
                }),
            }
        }
        lanes
    }

    /// Returns the next (episode, step) of this lane.
    fn take(&mut self, episodes: &[EpisodeRewards<'_>]) -> Option<(usize, usize)> {
        if self.next == self.end {
            return None;
        }
        let taken = (self.next, self.step);
        self.step += 1;
        if self.step == episodes[self.next].rewards.len() {
            (self.next, self.step) = (self.next + 1, 0);
        }
        Some(taken)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn constant_returns_leave_only_the_prior_spread() {
        let mut scale = RewardScale::default();
        let (mut first, mut second) = ([1.0f32; 3], [1.0f32; 2]);
        let mut episodes = [
            EpisodeRewards { lane: 0, rewards: &mut first },
            EpisodeRewards { lane: 1, rewards: &mut second },
        ];
        scale.apply(&mut episodes, 0.0);
        assert!((scale.returns.mean - 1.0).abs() < 1e-3);
        assert!(scale.returns.count > 5.0);
        assert!((scale.returns.variance - 2e-4 / 5.0001).abs() < 1e-7);
        assert!(first.iter().all(|reward| reward.is_finite() && *reward > 0.0));
    }

    #[test]
    fn lanes_are_walked_side_by_side_and_their_episodes_one_after_another() {
        let mut together = RewardScale::default();
        let (mut short, mut long, mut other) = ([0.5f32], [-1.0f32, 0.75], [2.0f32, 0.25]);
        let mut episodes = [
            EpisodeRewards { lane: 0, rewards: &mut short },
            EpisodeRewards { lane: 0, rewards: &mut long },
            EpisodeRewards { lane: 1, rewards: &mut other },
        ];
        together.apply(&mut episodes, 0.9);
        let mut by_hand = RewardScale::default();
        by_hand.include(&[0.5, 2.0]);
        let scale = by_hand.returns.standard_deviation();
        assert_eq!((short[0], other[0]), ((0.5 / scale) as f32, (2.0 / scale) as f32));
        // The return begins anew with the second episode of lane 0.
        by_hand.include(&[-1.0, 2.0 * 0.9 + 0.25]);
        let scale = by_hand.returns.standard_deviation();
        assert_eq!((long[0], other[1]), ((-1.0 / scale) as f32, (0.25 / scale) as f32));
        by_hand.include(&[0.75 - 0.9]);
        assert_eq!(long[1], (0.75 / by_hand.returns.standard_deviation()) as f32);
        assert_eq!(together, by_hand);
    }
}
