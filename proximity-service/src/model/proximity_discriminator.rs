//! Proximity times the probability that a state is the expert's: close to the goal, and where the
//! expert would be. Rank2Reward (arXiv 2404.14735) multiplies a ranking so.

use std::time::Duration;

use anyhow::Result;
use protocol::digest;
use protocol::messages::{Estimates, RewardUpdate, Score};
use protocol::tensors::Tensors;
use protocol::trajectory::Encoded;
use run::config::{RewardConfig, RewardForm, RunConfig};
use run::folder::RunFolder;
use run::process::Final;

use super::{Discriminator, GoalProximity, Learned, RewardModel, Slice};
use crate::reward::rewards;

/// Both models, with the same settings. Losses are those of proximity. Both begin with the same weights and
/// draw by the same streams: nothing asks them to be independent.
pub struct ProximityDiscriminator {
    config: RewardConfig,
    proximity: Learned<GoalProximity>,
    discriminator: Learned<Discriminator>,
}

impl ProximityDiscriminator {
    pub(super) fn of_run(folder: &RunFolder, config: &RunConfig) -> Result<Box<dyn RewardModel>> {
        // A discriminator has a form of its own; its rewards are not used.
        let told_apart = RewardConfig { form: RewardForm::Airl, ..config.reward.clone() };
        let told_apart = RunConfig { reward: told_apart, ..config.clone() };
        Ok(Box::new(ProximityDiscriminator {
            proximity: Learned::of_run(folder, config)?,
            discriminator: Learned::of_run(folder, &told_apart)?,
            config: config.reward.clone(),
        }))
    }

    /// An update of both.
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
    /// A discriminator has nothing to learn yet.
    fn pretrain(&mut self, time: Duration) -> Result<Slice, Final> {
        let own = match self.proximity.pretrain(time)? {
            Slice::Done(own) => own,
            under_way => return Ok(under_way),
        };
        match self.discriminator.pretrain(Duration::MAX)? {
            Slice::Done(others) => Ok(Slice::Done(self.joined(own, &others))),
            under_way => Ok(under_way),
        }
    }

    fn improve(&mut self, iteration: u64, batch: &[Encoded]) -> Result<RewardUpdate, Final> {
        let own = self.proximity.improve(iteration, batch)?;
        let others = self.discriminator.improve(iteration, batch)?;
        Ok(self.joined(own, &others))
    }

    /// The uncertainty is that of proximity.
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

/// What the names of its arrays in a checkpoint begin with.
const DISCRIMINATOR: &str = "discriminator.";

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
        let rate = LearningRate { first: 0.01, iterations: None };
        let threads = || rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let demonstrations = [walk(0.0, Source::Demonstration)];
        let told_apart = RewardConfig { form: RewardForm::Airl, ..settings() };
        ProximityDiscriminator {
            proximity: Learned::new(&CORRIDOR, &settings(), rate, 1, &demonstrations, threads()),
            discriminator: Learned::new(
                &CORRIDOR,
                &told_apart,
                rate,
                1,
                &demonstrations,
                threads(),
            ),
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
        let scores = model.score(60, &batch);
        let expected = rewards(&scores[1].proximity, &scores[1].uncertainty, &settings());
        assert_eq!(scores[1].rewards, expected);
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
