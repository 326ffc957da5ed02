//! Proximity times the probability that a state is the expert's, which is high close to the goal where the expert
//! would be. Rank2Reward (arXiv 2404.14735) multiplies a ranking in this way.

use std::time::Duration;

use anyhow::Result;
use networks::Squashing;
use protocol::digest;
use protocol::messages::{Estimates, RewardUpdate, Score};
use protocol::tensors::Tensors;
use protocol::trajectory::{Encoded, Trajectory};
use run::config::{RewardConfig, RunConfig};
use run::folder::RunFolder;
use run::process::Final;

use super::input::Input;
use super::minibatch::{Losses, Minibatch, Positions};
use super::{Discriminator, GoalProximity, Learned, Objective, RewardModel, Sampler, Slice};
use crate::reward::rewards;

/// Both models, with the same settings. Reported losses are those of proximity. Both models start with the same
/// weights and use the same random streams, since they need not be independent.
pub struct ProximityDiscriminator {
    config: RewardConfig,
    proximity: Learned<GoalProximity>,
    discriminator: Learned<StateDiscriminator>,
}

impl ProximityDiscriminator {
    pub(super) fn of_run(folder: &RunFolder, config: &RunConfig) -> Result<Box<dyn RewardModel>> {
        let demonstrations = run::origin::load_demonstrations(folder, config)?;
        Ok(Box::new(ProximityDiscriminator {
            proximity: Learned::of_run(config, &demonstrations)?,
            discriminator: Learned::of_run(config, &demonstrations)?,
            config: config.reward.clone(),
        }))
    }

    /// Combines the updates of both models.
    fn joined(&self, proximity: RewardUpdate, discriminator: &RewardUpdate) -> RewardUpdate {
        RewardUpdate {
            gradient_steps: proximity.gradient_steps + discriminator.gradient_steps,
            seconds: proximity.seconds + discriminator.seconds,
            weights_sha256: self.sha256(),
            ..proximity
        }
    }
}

fn products(proximity: &[f32], probability: &[f32]) -> Vec<f32> {
    proximity.iter().zip(probability).map(|(one, other)| one * other).collect()
}

impl RewardModel for ProximityDiscriminator {
    /// Trains proximity; the discriminator has nothing to learn yet.
    fn pretrain(&mut self, time: Duration) -> Result<Slice, Final> {
        let own = match self.proximity.pretrain(time)? {
            Slice::Done(own) => own,
            under_way => return Ok(under_way),
        };
        let Slice::Done(others) = self.discriminator.pretrain(Duration::MAX)? else {
            unreachable!("a discriminator has no minibatches offline")
        };
        Ok(Slice::Done(self.joined(own, &others)))
    }

    fn improve(&mut self, iteration: u64, batch: &[Encoded]) -> Result<RewardUpdate, Final> {
        let own = self.proximity.improve(iteration, batch)?;
        let others = self.discriminator.improve(iteration, batch)?;
        Ok(self.joined(own, &others))
    }

    /// Scores with the product; the uncertainty is that of proximity.
    fn score(&self, iteration: u64, batch: &[Encoded]) -> Vec<Score> {
        let proximity = self.proximity.score(iteration, batch);
        let probability = self.discriminator.score(iteration, batch);
        let product = |(score, probability): (Score, &Score)| {
            let proximity = products(&score.proximity, &probability.proximity);
            let rewards = rewards(&proximity, &score.uncertainty, &self.config);
            Score { rewards, proximity, ..score }
        };
        proximity.into_iter().zip(&probability).map(product).collect()
    }

    fn estimate(&self, observations: &[u8]) -> Result<Estimates> {
        let proximity = self.proximity.estimate(observations)?;
        let probability = self.discriminator.estimate(observations)?;
        let product = products(&proximity.proximity, &probability.proximity);
        Ok(Estimates { proximity: product, ..proximity })
    }

    fn sha256(&self) -> String {
        digest::sha256([self.proximity.sha256(), self.discriminator.sha256()])
    }

    fn save(&self) -> Tensors {
        let mut tensors = self.proximity.save();
        tensors.put_all(DISCRIMINATOR, self.discriminator.save());
        tensors
    }

    fn restore(&mut self, tensors: &Tensors) -> Result<(), String> {
        self.proximity.restore(tensors)?;
        self.discriminator.restore(&tensors.all(DISCRIMINATOR))
    }
}

/// Name prefix of the discriminator's arrays in a checkpoint.
const DISCRIMINATOR: &str = "discriminator.";

/// A discriminator of every state that proximity is learned from, including the one at the goal, which the reward
/// of the last step needs.
struct StateDiscriminator;

impl Objective for StateDiscriminator {
    const SQUASHING: Squashing = Discriminator::SQUASHING;

    fn new(_config: &RewardConfig, _input: &Input, _demonstrations: &[Trajectory]) -> Self {
        StateDiscriminator
    }

    fn offline(&self, sampler: &Sampler<'_>) -> Vec<Positions> {
        Discriminator.offline(sampler)
    }

    fn losses(&self, minibatch: &Minibatch, outputs: &[f32], gradients: &mut [f32]) -> Losses {
        Discriminator.losses(minibatch, outputs, gradients)
    }
}

#[cfg(test)]
mod tests {
    use run::learning_rate::LearningRate;

    use super::*;
    use crate::tests::{CORRIDOR, config, place, pretrained, walk};
    use protocol::trajectory::Source;

    fn settings() -> RewardConfig {
        RewardConfig { batch: 5, samples: 10, ..config() }
    }

    fn model(threads: usize) -> ProximityDiscriminator {
        shown(&[walk(0.0, Source::Demonstration)], threads)
    }

    fn shown(demonstrations: &[Trajectory], threads: usize) -> ProximityDiscriminator {
        fn learned<O: Objective>(demonstrations: &[Trajectory], threads: usize) -> Learned<O> {
            let rate = LearningRate { first: 0.01, iterations: None };
            let threads = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            Learned::new(&CORRIDOR, &settings(), rate, 1, demonstrations, threads)
        }
        ProximityDiscriminator {
            proximity: learned(demonstrations, threads),
            discriminator: learned(demonstrations, threads),
            config: settings(),
        }
    }

    #[test]
    fn a_state_is_close_only_where_the_expert_would_be() {
        let batch = [1.0, 0.0].map(|row| Encoded::encode(walk(row, Source::Training)));
        let mut model = model(1);
        pretrained(&mut model);
        for iteration in 0..60 {
            let update = model.improve(iteration, &batch[..1]).unwrap();
            assert_eq!(update.gradient_steps, 4, "two of each");
        }
        let [agents, experts] = [1.0, 0.0].map(|row| {
            let at = place(0.9, row);
            let whole = model.estimate(&at).unwrap().proximity[0];
            (whole, model.proximity.estimate(&at).unwrap().proximity[0])
        });
        assert!(experts.0 > 0.5 && agents.0 < 0.2 && agents.0 < agents.1, "{experts:?} {agents:?}");
        let at_the_end =
            [0.0, 1.0].map(|row| model.estimate(&place(1.0, row)).unwrap().proximity[0]);
        assert!(at_the_end[0] > 0.5 && at_the_end[1] < 0.2, "{at_the_end:?}");
        let scores = model.score(60, &batch);
        let expected = rewards(&scores[1].proximity, &scores[1].uncertainty, &settings());
        assert_eq!(scores[1].rewards, expected);
    }

    /// Places the goal where a discriminator of the states before it would take it for the agent's.
    #[test]
    fn the_state_at_the_goal_is_learned_too() {
        let expert = walk(0.0, Source::Demonstration);
        let goal = place(1.0, 3.0);
        let values = [&expert.values[..10 * goal.len()], &goal[..]].concat();
        let mut model = shown(&[Trajectory { values: values.into(), ..expert }], 1);
        pretrained(&mut model);
        let batch = [Encoded::encode(walk(1.0, Source::Training))];
        for iteration in 0..250 {
            model.improve(iteration, &batch).unwrap();
        }
        let found = model.estimate(&goal).unwrap().proximity[0];
        assert!(found > 0.5, "{found}");
    }

    #[test]
    fn threads_change_no_bit_and_a_restored_model_goes_on_alike() {
        let batch = [Encoded::encode(walk(1.0, Source::Training))];
        let (mut one, mut other) = (model(1), model(3));
        pretrained(&mut one);
        one.improve(0, &batch).unwrap();
        other.restore(&one.save()).unwrap();
        let updates = [one.improve(1, &batch), other.improve(1, &batch)].map(Result::unwrap);
        assert_eq!(updates[0].weights_sha256, updates[1].weights_sha256);
        assert_eq!(one.score(2, &batch), other.score(2, &batch));
    }
}
