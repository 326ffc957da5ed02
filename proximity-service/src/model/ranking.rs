//! Proximity by ranking (Figure 7): of two states of a demonstration, the later one is closer to the goal, and a
//! state of the expert is closer than one of the agent.
//!
//! Ranking does not determine a scale, so the proximity is the mean of the sigmoids of the members' outputs. It is
//! in [0, 1], and the rewards are computed from it as from the regressed proximity. The loss uses the outputs
//! themselves.

use networks::{Squashing, ranking};
use protocol::seed::Stream;
use protocol::trajectory::Trajectory;
use rand::RngExt;
use run::config::RewardConfig;

use super::input::Input;
use super::minibatch::{Losses, Minibatch, Positions};
use super::objective::{Objective, Sampler};

/// Ranking of rows within demonstrations, and of the expert's rows above the agent's.
#[derive(Clone, Debug, PartialEq)]
pub struct Ranking {
    /// First row of each demonstration, and the end of the last one.
    starts: Vec<usize>,
    /// Cumulative number of pairs, up to and including each demonstration.
    pairs: Vec<usize>,
}

impl Ranking {
    /// Draws pairs uniformly from all pairs within a demonstration. Returns the later rows, then the earlier ones.
    fn draw(&self, count: usize, stream: &mut Stream) -> Vec<usize> {
        let all = self.pairs.last().copied().unwrap_or(0);
        let (mut later, mut earlier) = (Vec::new(), Vec::new());
        for _ in 0..count {
            let pair = stream.random_range(0..all as u64) as usize;
            let number = self.pairs.partition_point(|&end| end <= pair);
            let rows = self.starts[number + 1] - self.starts[number];
            let first = stream.random_range(0..rows as u64) as usize;
            let other = stream.random_range(0..rows as u64 - 1) as usize;
            let second = if other < first { other } else { other + 1 };
            later.push(self.starts[number] + first.max(second));
            earlier.push(self.starts[number] + first.min(second));
        }
        later.extend(earlier);
        later
    }
}

impl Objective for Ranking {
    const SQUASHING: Squashing = Squashing::MeanOfSigmoids;

    fn new(_config: &RewardConfig, input: &Input, demonstrations: &[Trajectory]) -> Self {
        let mut order = Ranking { starts: vec![0], pairs: Vec::new() };
        let (mut rows, mut pairs) = (0, 0);
        for trajectory in demonstrations {
            let own = input.places(trajectory.steps as usize);
            rows += own;
            pairs += own * (own - 1) / 2;
            order.starts.push(rows);
            order.pairs.push(pairs);
        }
        order
    }

    /// Draws as many pairs per epoch as the demonstrations have rows, in full batches.
    fn offline(&self, sampler: &Sampler<'_>) -> Vec<Positions> {
        sampler.offline_pairs(|pairs, stream| self.draw(pairs, stream))
    }

    /// Adds as many pairs within demonstrations, before the expert's rows that are paired with the agent's.
    fn online(&self, sampler: &Sampler<'_>, agent: usize, stream: &mut Stream) -> Vec<Positions> {
        let mut minibatches = sampler.online_pairs(agent, stream);
        for minibatch in &mut minibatches {
            let mut within = self.draw(minibatch.agent.len(), stream);
            within.append(&mut minibatch.demonstrations);
            minibatch.demonstrations = within;
        }
        minibatches
    }

    /// Computes the mean over pairs within demonstrations, and the mean over pairs of expert and agent.
    fn losses(&self, minibatch: &Minibatch, outputs: &[f32], gradients: &mut [f32]) -> Losses {
        let across = 2 * minibatch.positions.agent.len();
        let within = outputs.len() - across;
        let loss = |outputs: &[f32], gradients: &mut [f32]| {
            let half = outputs.len() / 2;
            let (above, below) = outputs.split_at(half);
            let (above_gradients, below_gradients) = gradients.split_at_mut(half);
            ranking(above, below, 1.0 / half.max(1) as f32, [above_gradients, below_gradients])
        };
        let (own_gradients, agent_gradients) = gradients.split_at_mut(within);
        Losses {
            demonstrations: loss(&outputs[..within], own_gradients),
            agent: loss(&outputs[within..], agent_gradients),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{Learned, RewardModel};
    use crate::tests::{CORRIDOR, assert_reproducible, config, learned, place, pretrained, walk};
    use protocol::seed::{self, Purpose};
    use protocol::trajectory::{Encoded, Source};
    use run::config::RewardInput;

    #[test]
    fn pairs_are_of_one_demonstration_and_uniform() {
        let mut long = walk(0.0, Source::Demonstration);
        long.steps = 2;
        let short = Trajectory { steps: 1, ..long.clone() };
        let order =
            Ranking::new(&config(), &Input::new(&CORRIDOR, RewardInput::State), &[short, long]);
        let mut stream = seed::stream(1, Purpose::PretrainingBatches, 0, 0);
        let rows = order.draw(4000, &mut stream);
        let pairs = rows[..4000].iter().zip(&rows[4000..]);
        for expected in [(1, 0), (3, 2), (4, 2), (4, 3)] {
            let found = pairs.clone().filter(|(later, earlier)| (**later, **earlier) == expected);
            let count = found.count();
            assert!(count.abs_diff(1000) < 120, "{expected:?} came {count} times");
        }
    }

    #[test]
    fn states_are_ranked_by_their_place_and_above_those_of_the_agent() {
        let mut model: Learned<Ranking> = learned(&config(), 2);
        assert_eq!(pretrained(&mut model).gradient_steps, 200);
        let proximity = |model: &Learned<Ranking>, at: f32, row: f32| {
            model.estimate(&place(at, row)).unwrap().proximity[0]
        };
        let found: Vec<f32> =
            (0..11).map(|tenths| proximity(&model, tenths as f32 / 10.0, 0.0)).collect();
        assert!(found.is_sorted_by(|one, other| one < other), "{found:?}");
        let before = proximity(&model, 0.9, 1.0);
        let batch = [Encoded::encode(walk(1.0, Source::Training))];
        for iteration in 0..80 {
            let update = model.improve(iteration, &batch).unwrap();
            assert!(update.agent_loss > 0.0 && update.demonstration_loss > 0.0);
        }
        let after = [proximity(&model, 0.9, 0.0), proximity(&model, 0.9, 1.0)];
        assert!(after[0] > after[1] + 0.2, "before {before}, after {after:?}");
    }

    #[test]
    fn threads_change_no_bit_and_a_restored_model_goes_on_alike() {
        for input in [RewardInput::State, RewardInput::StateAction] {
            // With actions the walk has ten rows.
            let config = RewardConfig { input, batch: 10, ..config() };
            assert_reproducible::<Ranking>(&config);
        }
    }
}
