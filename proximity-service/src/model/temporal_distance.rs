//! Pairwise temporal distance (TimeRewarder, arXiv 2509.26627): how much closer to the goal the second of two
//! states is than the first, learned from pairs of a demonstration in either order. A step earns the ensemble's
//! output for the states before and after it.
//!
//! TimeRewarder classifies distances into bins; this model uses regression, as for proximity. It learns nothing
//! from the agent's experience: a step back is a pair in reverse order.

use networks::{RowScore, Squashing, squared_error};
use protocol::seed::Stream;
use protocol::trajectory::Trajectory;
use rand::RngExt;
use run::config::RewardConfig;

use super::input::Input;
use super::minibatch::{Losses, Minibatch, Positions};
use super::objective::{EpisodeView, Objective, Sampler};
use crate::reward::step_rewards;

/// Regression on the distance between two observations of a demonstration.
#[derive(Clone, Debug, PartialEq)]
pub struct TemporalDistance {
    /// First observation of each demonstration, and the end of the last one.
    starts: Vec<usize>,
    /// Demonstration of each observation.
    owners: Vec<usize>,
    /// Distance label in [0, 1] for each number of steps towards the goal.
    distances: Vec<f32>,
}

impl TemporalDistance {
    /// Draws a pair: any observation, and another one of the same demonstration.
    fn pair(&self, stream: &mut Stream) -> [usize; 2] {
        let one = stream.random_range(0..self.owners.len() as u64) as usize;
        [one, self.other(one, stream)]
    }

    /// Draws the second observation of a pair, in either direction. The logarithm of the gap is uniform, so short
    /// gaps are frequent.
    fn other(&self, one: usize, stream: &mut Stream) -> usize {
        let owner = self.owners[one];
        let (first, last) = (self.starts[owner], self.starts[owner + 1] - 1);
        let (before, after) = (one - first, last - one);
        let forwards = before == 0 || (after > 0 && stream.random_bool(0.5));
        let most = if forwards { after } else { before };
        let gap = libm::pow(most as f64 + 1.0, stream.random()) as usize;
        let gap = gap.clamp(1, most);
        if forwards { one + gap } else { one - gap }
    }

    fn target(&self, from: usize, to: usize) -> f32 {
        let distance = self.distances[from.abs_diff(to)];
        if to > from { distance } else { -distance }
    }
}

impl Objective for TemporalDistance {
    const SQUASHING: Squashing = Squashing::ClampedMean;

    fn new(config: &RewardConfig, _input: &Input, demonstrations: &[Trajectory]) -> Self {
        let mut starts = vec![0];
        let mut owners = Vec::new();
        for (number, trajectory) in demonstrations.iter().enumerate() {
            owners.extend(vec![number; trajectory.steps as usize + 1]);
            starts.push(owners.len());
        }
        let longest = demonstrations.iter().map(|trajectory| trajectory.steps).max().unwrap_or(0);
        let distance = |steps| 1.0 - config.label(steps) as f32;
        TemporalDistance { starts, owners, distances: (0..=longest).map(distance).collect() }
    }

    /// Returns the length of one observation, since training draws observations and combines them in pairs.
    fn kept_bytes(input: &Input) -> usize {
        input.row_bytes() / input.frames()
    }

    fn append_training_rows(&self, _input: &Input, seen: EpisodeView<'_>, rows: &mut Vec<u8>) {
        rows.extend(seen.observations);
    }

    fn append_scored_rows(&self, input: &Input, seen: EpisodeView<'_>, rows: &mut Vec<u8>) {
        input.append_steps(seen.observations, seen.actions, rows);
    }

    /// Draws as many pairs per epoch as the demonstrations have observations, in full batches.
    fn offline(&self, sampler: &Sampler<'_>) -> Vec<Positions> {
        sampler.offline_pairs(|pairs, stream| (0..pairs).flat_map(|_| self.pair(stream)).collect())
    }

    fn losses(&self, minibatch: &Minibatch, outputs: &[f32], gradients: &mut [f32]) -> Losses {
        let pairs = minibatch.positions.demonstrations.chunks_exact(2);
        let targets: Vec<f32> = pairs.map(|pair| self.target(pair[0], pair[1])).collect();
        let weight = 1.0 / targets.len().max(1) as f32;
        let demonstrations = squared_error(outputs, &targets, weight, gradients);
        Losses { demonstrations, agent: 0.0 }
    }

    fn rewards(&self, rows: &[RowScore], _steps: usize, config: &RewardConfig) -> Vec<f32> {
        step_rewards(rows, config)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{Learned, RewardModel};
    use crate::tests::{config, learned, pretrained, walk, walk_back};
    use protocol::seed::{self, Purpose};
    use protocol::trajectory::{Encoded, Source};
    use run::config::{RewardInput, RewardModelKind};

    fn transitions() -> RewardConfig {
        let model = RewardModelKind::named("temporal-distance").unwrap();
        RewardConfig { model, input: RewardInput::Transition, uncertainty: 0.0, ..config() }
    }

    #[test]
    fn pairs_are_of_one_demonstration_in_either_order_and_mostly_close() {
        let long = walk(0.0, Source::Demonstration);
        let short = Trajectory { steps: 1, ..long.clone() };
        let input = Input::new(&crate::tests::CORRIDOR, RewardInput::Transition);
        let model = TemporalDistance::new(&transitions(), &input, &[short, long]);
        let mut stream = seed::stream(1, Purpose::PretrainingBatches, 0, 0);
        assert_eq!([0, 1].map(|one| model.other(one, &mut stream)), [1, 0]);
        let mut counts = [0; 13];
        (0..4000).for_each(|_| counts[model.other(7, &mut stream)] += 1);
        assert_eq!(counts[..2], [0, 0]);
        assert!(counts[2..7].is_sorted() && counts[8..].is_sorted_by(|a, b| a >= b), "{counts:?}");
        assert!(counts[2..7].iter().sum::<u32>().abs_diff(2000) < 130, "{counts:?}");
        assert_eq!(counts[7], 0);
        assert!(
            (model.target(2, 5) - 0.3).abs() < 1e-6 && model.target(5, 2) == -model.target(2, 5)
        );
    }

    #[test]
    fn a_step_towards_the_goal_earns_as_much_as_one_back_costs() {
        let mut model: Learned<TemporalDistance> = learned(&transitions(), 2);
        assert_eq!(pretrained(&mut model).gradient_steps, 200);
        let batch = [walk(0.0, Source::Training), walk_back(0.0, Source::Training)];
        let scores = model.score(0, &batch.map(Encoded::encode));
        for (score, expected) in scores.iter().zip([0.1, -0.1]) {
            assert_eq!(score.rewards.len(), 10);
            assert!(
                score.rewards.iter().all(|reward| (reward - expected).abs() < 0.05),
                "{score:?}"
            );
        }
    }

    #[test]
    fn what_the_agent_sees_changes_nothing_and_threads_change_no_bit() {
        let mut one: Learned<TemporalDistance> = learned(&transitions(), 1);
        let before = pretrained(&mut one).weights_sha256;
        let batch = [Encoded::encode(walk(1.0, Source::Training))];
        let update = one.improve(0, &batch).unwrap();
        assert_eq!((update.gradient_steps, update.weights_sha256), (0, before));
        let mut other: Learned<TemporalDistance> = learned(&transitions(), 3);
        other.restore(&one.save()).unwrap();
        assert_eq!(one.score(1, &batch), other.score(1, &batch));
    }
}
