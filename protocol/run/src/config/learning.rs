//! Checks that a run of a configuration can learn something: values that are valid one by one may contradict
//! each other. Only configurations that are to be trained are checked; recorded ones are read as they are.

use mcap_log::file::LONGEST_MESSAGE;
use protocol::Error;
use protocol::error::within;
use protocol::trajectory::Trajectory;

use super::{Discounting, RewardConfig, RewardInput, RewardModelKind, RunConfig};

/// Least label of a state two steps from the goal, and least decrease of labels over an episode.
const LEAST_LABEL: f64 = 0.01;

impl RunConfig {
    pub(super) fn check_learning(&self) -> Result<(), Error> {
        self.check_magnitudes()?;
        self.check_longest_episode()?;
        self.check_policy_learner()?;
        self.check_segments()?;
        if self.reward.model.trains {
            self.check_arrival()?;
            self.check_ensemble()?;
        }
        if self.reward.model.labels { self.check_labels() } else { Ok(()) }
    }

    /// Refuses values so small that no weight moves, or so large that 32-bit floats cannot hold
    /// them. A learning rate that makes training diverge passes: the first update then fails.
    fn check_magnitudes(&self) -> Result<(), Error> {
        const RATE: [f64; 2] = [1e-9, 1e30];
        const EPSILON: [f64; 2] = [1e-20, 1.0];
        const NORM: [f64; 2] = [1e-9, 1e9];
        const SOME: [f64; 2] = [1e-6, 1e6];
        const ANY: [f64; 2] = [0.0, 1e6];
        const SIGNED: [f64; 2] = [-1e6, 1e6];
        const SHARE: [f64; 2] = [0.0, 1.0];
        let (ppo, reward) = (&self.ppo, &self.reward);
        let mut numbers = vec![
            ("ppo.learning_rate", ppo.learning_rate, RATE),
            ("ppo.adam_epsilon", ppo.adam_epsilon, EPSILON),
            ("ppo.max_gradient_norm", ppo.max_gradient_norm, NORM),
            ("ppo.clip", ppo.clip, SOME),
            ("ppo.value_clip", ppo.value_clip, ANY),
            ("ppo.value_coefficient", ppo.value_coefficient, ANY),
            ("ppo.entropy_coefficient", ppo.entropy_coefficient, ANY),
            ("reward.learning_rate", reward.learning_rate, RATE),
            ("reward.uncertainty", reward.uncertainty, ANY),
            ("reward.offset", reward.offset, SIGNED),
            ("reward.gradient_penalty", reward.gradient_penalty, ANY),
            ("reward.agent_weight", reward.agent_weight, ANY),
            ("reward.arrival", reward.arrival, SHARE),
            ("reward.weight_decay", reward.weight_decay, ANY),
            ("reward.prior", reward.prior, ANY),
        ];
        if let Some(cloning) = &self.cloning {
            numbers.push(("cloning.learning_rate", cloning.learning_rate, RATE));
            numbers.push(("cloning.adam_epsilon", cloning.adam_epsilon, EPSILON));
            numbers.push(("cloning.max_gradient_norm", cloning.max_gradient_norm, NORM));
        }
        if let Some(inverse) = &self.inverse_dynamics {
            numbers.push(("inverse_dynamics.learning_rate", inverse.learning_rate, RATE));
        }
        if let Some(sqil) = &self.sqil {
            numbers.push(("sqil.learning_rate", sqil.learning_rate, RATE));
            numbers.push(("sqil.temperature", sqil.temperature, SOME));
        }
        for (key, found, [least, most]) in numbers {
            let expected = format!("between {least:e} and {most:e}");
            within(key, (least..=most).contains(&found), &expected, found)?;
        }
        Ok(())
    }

    /// Requires that the longest episode fits into a message of the log: otherwise the first long
    /// episode would end the run. It may fit without observations, if these can be left out.
    fn check_longest_episode(&self) -> Result<(), Error> {
        let (spec, kept) = (self.task.spec(), self.log.observations);
        let [bytes, acted] = [kept, false].map(|kept| Trajectory::most_bytes(&spec, kept));
        let most = LONGEST_MESSAGE as u64;
        let (steps, holds) = (spec.horizon_steps, bytes <= most);
        let why = format!(
            "an episode of {steps} steps has {bytes} bytes, a message of the log at most {most}"
        );
        if self.task.deterministic && !self.learner.replays() && acted <= most {
            within("log.observations", holds, &format!("false: {why}"), kept)
        } else {
            within("task.horizon_steps", holds, &format!("smaller: {why}"), steps)
        }
    }

    fn check_policy_learner(&self) -> Result<(), Error> {
        let (learner, model) = (self.learner.name(), self.reward.model.name);
        let rewarded = self.learner.is_rewarded() || !self.reward.model.rewards;
        let expected = format!("none for {learner}, which asks for no rewards");
        within("reward.model", rewarded, &expected, model)?;
        self.learner.check_learning(self)
    }

    /// Requires that the longest episode has at least as many states as there are segments:
    /// otherwise its last segment has none.
    fn check_segments(&self) -> Result<(), Error> {
        let segments = self.reward.segments;
        let states = self.task.horizon_steps as usize + 1;
        let holds = segments <= states || !self.reward.model.reads_segments();
        let expected = format!("at most {states}, the states of the longest episode");
        within("reward.segments", holds, &expected, segments)
    }

    /// Requires an ensemble that can estimate an arrival. Before a discriminator is trained, its probability is about
    /// the same in all states: the first would count as the arrival, and no step of the agent would ever be kept.
    fn check_arrival(&self) -> Result<(), Error> {
        let RewardConfig { model, input, arrival, .. } = self.reward;
        let discriminates = model.has_discriminator();
        let expected = match discriminates {
            true => "0 with a discriminator, whose probability does not say how close the goal is",
            false => "0 unless the reward model is one of single states",
        };
        let estimates = input == RewardInput::State && !discriminates;
        let holds = arrival <= 0.0 || estimates || !self.reward.trains_online();
        within("reward.arrival", holds, expected, arrival)
    }

    fn check_ensemble(&self) -> Result<(), Error> {
        let reward = &self.reward;
        let RewardModelKind { name, online, .. } = *reward.model;
        let (samples, kept, epochs) =
            (reward.samples, reward.experience, reward.pretraining_epochs);
        if online {
            let expected = format!("at most reward.experience = {kept}");
            within("reward.samples", samples <= kept, &expected, samples)?;
            let learns = samples > 0 || !reward.model.has_discriminator();
            within("reward.samples", learns, "above 0 for a discriminator", 0)?;
            let trains = samples > 0 || epochs > 0;
            let expected = "above 0 with reward.pretraining_epochs = 0";
            within("reward.samples", trains, expected, samples)?;
        } else {
            let expected = format!("at least 1 with {name}, which learns nothing later");
            within("reward.pretraining_epochs", epochs >= 1, &expected, epochs)?;
        }
        let (episodes, horizon) = (self.demonstrations.episodes, self.task.spec().horizon_steps);
        let most = episodes.saturating_mul(reward.model.rows(reward.input, u64::from(horizon)));
        let expected = format!(
            "at most the {most} rows that demonstrations.episodes = {episodes} can have, of at most \
             {horizon} steps"
        );
        within("reward.batch", reward.batch as u64 <= most, &expected, reward.batch)
    }

    /// Requires that labels tell near from far: they must neither vanish right next to the goal nor
    /// stay near 1 over a whole episode.
    fn check_labels(&self) -> Result<(), Error> {
        let (delta, horizon) = (self.reward.delta, self.task.spec().horizon_steps);
        let label = |steps: u32| self.reward.label(steps);
        let discounting = match self.reward.discounting {
            Discounting::Linear => "linear",
            Discounting::Exponential => "exponential",
        };
        let expected = format!(
            "such that {discounting} labels fall from 1 at the goal to {LEAST_LABEL} or more two \
             steps from it and to {} or less {horizon} steps from it",
            1.0 - LEAST_LABEL
        );
        let holds = label(2) >= LEAST_LABEL && label(horizon) <= 1.0 - LEAST_LABEL;
        within("reward.delta", holds, &expected, delta)
    }
}
