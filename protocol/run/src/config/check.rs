//! Checks the values of a configuration. All other code reads checked values only.

use protocol::encoder::CellsArchitecture;
use protocol::error::within;
use protocol::table::flat;
use protocol::task::ObservationSpec;
use protocol::{Error, MAX_ACTORS};

use super::settings::is_infinite;
use super::{
    InverseDynamicsConfig, RewardConfig, RewardForm, RewardInput, RewardModelKind, RunConfig,
};

/// Largest side of a pooled square: the position of a number in it is kept in a byte.
const POOL_MOST: usize = 16;

impl RunConfig {
    pub(super) fn check(&self) -> Result<(), Error> {
        let at_least_one = [
            ("demonstrations.episodes", self.demonstrations.episodes),
            ("rollout.lanes", self.rollout.lanes),
            ("rollout.lane_steps", self.rollout.lane_steps),
            ("policy.features", self.policy.features as u64),
            ("ppo.epochs", self.ppo.epochs),
            ("ppo.minibatches", self.ppo.minibatches),
            ("reward.features", self.reward.features as u64),
            ("reward.batch", self.reward.batch as u64),
            ("reward.experience", self.reward.experience as u64),
            ("checkpoint.iterations", self.checkpoint.iterations),
            ("checkpoint.keep", self.checkpoint.keep as u64),
            ("log.file_mib", self.log.file_mib),
            ("resources.lease_timeout_ms", self.resources.lease_timeout_ms),
        ];
        for (key, number) in at_least_one {
            within(key, number >= 1, "at least 1", number)?;
        }
        // Above these values, sums and sizes in bytes would overflow.
        let at_most = [
            ("rollout.lane_steps", self.rollout.lane_steps, 1 << 40),
            ("reward.experience", self.reward.experience as u64, 1 << 40),
            ("log.file_mib", self.log.file_mib, 1 << 20),
        ];
        for (key, number, most) in at_most {
            within(key, number <= most, &format!("at most {most}"), number)?;
        }
        self.task.check()?;
        self.check_finite()?;
        self.check_widths()?;
        self.check_encoders()?;
        self.check_limits()?;
        self.check_learner()?;
        self.check_reward()?;
        self.check_fractions()
    }

    /// Refuses infinite numbers and NaN in settings: environments get them as JSON, which has no such numbers.
    fn check_finite(&self) -> Result<(), Error> {
        let settings = [
            ("environment", &self.environment),
            ("demonstrations", &self.demonstrations.environment),
        ];
        for (table, setting) in settings {
            for (key, value) in flat(&setting.0) {
                within(&format!("{table}.{key}"), !is_infinite(&value), "finite", value)?;
            }
        }
        Ok(())
    }

    /// Refuses layers of width 0: they have no outputs, and the network after them no inputs.
    fn check_widths(&self) -> Result<(), Error> {
        let (policy, reward) = (&self.policy, &self.reward);
        let mut layers = vec![
            ("policy.convolution_channels", &policy.convolution_channels[..]),
            ("policy.hidden", &policy.hidden),
            ("reward.convolution_channels", &reward.convolution_channels),
            ("reward.hidden", &reward.hidden),
        ];
        if let Some(inverse) = &self.inverse_dynamics {
            layers.push(("inverse_dynamics.convolution_channels", &inverse.convolution_channels));
            layers.push(("inverse_dynamics.hidden", &inverse.hidden));
        }
        layers.extend(self.sqil.as_ref().map(|sqil| ("sqil.hidden", &sqil.hidden[..])));
        for (key, widths) in layers {
            within(key, !widths.contains(&0), "widths of at least 1", format!("{widths:?}"))?;
        }
        Ok(())
    }

    /// Requires that every convolution's kernel fits into the image before it.
    fn check_encoders(&self) -> Result<(), Error> {
        let ObservationSpec::Cells { height, width, .. } = self.task.spec().observation else {
            return Ok(());
        };
        let policy = ("policy", self.policy.encoder());
        let reward = self.reward.model.trains.then(|| ("reward", self.reward.encoder()));
        let inverse = self.inverse_dynamics.as_ref().map(InverseDynamicsConfig::encoder);
        let inverse = inverse.map(|encoder| ("inverse_dynamics", encoder));
        for (table, encoder) in [Some(policy), reward, inverse].into_iter().flatten() {
            let CellsArchitecture { channels, kernel, pool, .. } = &encoder;
            let key = |name: &str| format!("{table}.{name}");
            let (some, most) = (!channels.is_empty(), POOL_MOST);
            within(&key("convolution_channels"), some, "at least one", "none")?;
            let range = format!("1 to {most}");
            within(&key("pool"), (1..=most).contains(pool), &range, pool)?;
            let fits = encoder.images([height, width]).is_some();
            let layers = channels.len();
            let expected = format!(
                "such that {layers} convolutions fit {height} x {width}, with {pool} x {pool} \
                 pooling after the first"
            );
            within(&key("convolution_kernel"), fits, &expected, kernel)?;
        }
        Ok(())
    }

    fn check_learner(&self) -> Result<(), Error> {
        within("steps", self.steps >= 1 || !self.learner.acts(), "at least 1", self.steps)?;
        if let Some(cloning) = &self.cloning {
            cloning.check()?;
        }
        if let Some(inverse) = &self.inverse_dynamics {
            inverse.check()?;
        }
        if let Some(sqil) = &self.sqil {
            sqil.check()?;
        }
        self.learner.check(self)?;
        let replays = self.learner.replays();
        let kept = self.log.observations;
        let expected = format!("true for {}", self.learner.name());
        within("log.observations", kept || !replays, &expected, kept)?;
        let acts_again = self.task.deterministic;
        let expected = "true for a task whose episodes cannot be re-simulated";
        within("log.observations", kept || acts_again, expected, kept)
    }

    fn check_reward(&self) -> Result<(), Error> {
        let reward = &self.reward;
        let rewards = reward.model.rewards || !self.learner.is_rewarded();
        within("reward.model", rewards, &format!("some for {}", self.learner.name()), "none")?;
        let RewardModelKind { name, trains, inputs, forms, pairs, .. } = *reward.model;
        let segments = reward.segments;
        within("reward.segments", (1..=1000).contains(&segments), "from 1 to 1000", segments)?;
        if !trains {
            return Ok(());
        }
        let one_of = |names: Vec<String>| format!("{} with {name}", names.join(" or "));
        let expected = one_of(forms.iter().map(RewardForm::to_string).collect());
        within("reward.form", forms.contains(&reward.form), &expected, reward.form)?;
        let expected = one_of(inputs.iter().map(RewardInput::to_string).collect());
        within("reward.input", inputs.contains(&reward.input), &expected, reward.input)?;
        let penalty = reward.gradient_penalty;
        let vector = matches!(self.task.spec().observation, ObservationSpec::Vector { .. });
        within(
            "reward.gradient_penalty",
            penalty >= 0.0 && penalty.is_finite(),
            "0 or above",
            penalty,
        )?;
        let holds = penalty == 0.0 || (reward.model.is_discriminator() && vector);
        within(
            "reward.gradient_penalty",
            holds,
            "0, except for a discriminator of vector observations",
            penalty,
        )?;
        let holds = penalty == 0.0 || reward.prior == 0.0;
        within("reward.prior", holds, "0 with reward.gradient_penalty", reward.prior)?;
        let expected = format!("false with {name}, whose rows belong together");
        within("reward.bootstrap", !pairs || !reward.bootstrap, &expected, true)
    }

    fn check_limits(&self) -> Result<(), Error> {
        let seed = self.seed;
        within("seed", seed <= i64::MAX as u64, "below 2^63", seed)?;
        within("rollout.lag", self.rollout.lag <= 1, "0 or 1", self.rollout.lag)?;
        within("rollout.lanes", self.rollout.lanes <= 4096, "at most 4096", self.rollout.lanes)?;
        let (lane_steps, horizon) = (self.rollout.lane_steps, self.task.spec().horizon_steps);
        let expected = format!("at least the longest episode, {horizon}");
        let holds = lane_steps >= u64::from(horizon) || !self.learner.acts();
        within("rollout.lane_steps", holds, &expected, lane_steps)?;
        let normalized = self.policy.normalize_observations;
        let vector = matches!(self.task.spec().observation, ObservationSpec::Vector { .. });
        within("policy.normalize_observations", vector || !normalized, "false for a grid", true)?;
        let normalized = self.reward.normalize_observations;
        within("reward.normalize_observations", vector || !normalized, "false for a grid", true)?;
        let actors = self.resources.actors;
        let most = format!("at most {MAX_ACTORS}");
        within("resources.actors", actors <= MAX_ACTORS as u64, &most, actors)?;
        let timeout_ms = self.resources.lease_timeout_ms;
        let expected = "at most a day, 86400000";
        within("resources.lease_timeout_ms", timeout_ms <= 86_400_000, expected, timeout_ms)?;
        let RewardConfig { ensemble, uncertainty, samples, batch, .. } = self.reward;
        within("reward.ensemble", (1..=32).contains(&ensemble), "1 to 32", ensemble)?;
        let holds = ensemble >= 2 || uncertainty <= 0.0;
        let expected = format!("at least 2 with reward.uncertainty = {uncertainty}");
        within("reward.ensemble", holds, &expected, ensemble)?;
        let fits = !self.reward.trains_online() || samples >= batch;
        let expected = format!("0 or at least reward.batch = {batch}");
        within("reward.samples", fits, &expected, samples)
    }

    fn check_fractions(&self) -> Result<(), Error> {
        let above_zero = [
            ("ppo.learning_rate", self.ppo.learning_rate),
            ("ppo.adam_epsilon", self.ppo.adam_epsilon),
            ("ppo.clip", self.ppo.clip),
            ("ppo.max_gradient_norm", self.ppo.max_gradient_norm),
            ("reward.learning_rate", self.reward.learning_rate),
        ];
        for (key, number) in above_zero {
            positive(key, number)?;
        }
        let not_negative = [
            ("ppo.value_clip", self.ppo.value_clip),
            ("ppo.value_coefficient", self.ppo.value_coefficient),
            ("ppo.entropy_coefficient", self.ppo.entropy_coefficient),
            ("ppo.target_kl", self.ppo.target_kl),
            ("reward.uncertainty", self.reward.uncertainty),
        ];
        for (key, number) in not_negative {
            within(key, number.is_finite() && number >= 0.0, "0 or above", number)?;
        }
        let offset = self.reward.offset;
        within("reward.offset", offset.is_finite(), "a finite number", offset)?;
        let unit = [
            ("ppo.gamma", self.ppo.gamma),
            ("ppo.gae_lambda", self.ppo.gae_lambda),
            ("reward.delta", self.reward.delta),
        ];
        for (key, number) in unit {
            within(key, number > 0.0 && number <= 1.0, "above 0 and at most 1", number)?;
        }
        Ok(())
    }
}

pub(super) fn positive(key: &str, number: f64) -> Result<(), Error> {
    within(key, number.is_finite() && number > 0.0, "above 0", number)
}
