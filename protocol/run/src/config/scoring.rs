//! The reward by which a trained model scores recorded episodes. Nothing is trained, so only what scoring reads can be
//! changed.

use std::collections::BTreeMap;

use protocol::Error;
use protocol::error::within;
use protocol::setting::is_same;
use protocol::table::{flat, merge};
use toml::Value;

use super::settings::{merged, with_likely_key};
use super::{RewardModelKind, RunConfig, parse};

/// Keys that scoring with a trained ensemble reads.
const READ: [&str; 5] =
    ["reward.model", "reward.form", "reward.final_bonus", "reward.uncertainty", "reward.offset"];

impl RunConfig {
    /// Returns the configuration of a trained run with `key=value` settings of its reward laid over it, to score with
    /// the run's model, or with one that learns nothing in its place. Whether a run could learn with these settings
    /// does not matter.
    ///
    /// # Errors
    /// For the first setting that is not `key=value`, unknown, out of range, without effect, or read by training only.
    pub fn for_scoring(&self, settings: &[String]) -> Result<Self, Error> {
        let mut table = parse(&self.to_text(), "configuration")?;
        let changes = merged(settings)?;
        let (before, set) = (flat(&table), flat(&changes));
        self.check_is_trained(&set, &before)?;
        merge(&mut table, changes);
        let likely = |refused| with_likely_key(refused, &set, &before);
        let config = Self::from_table(table, "--set").map_err(likely)?;
        config.check_all_is_read(&set, &before)?;
        Ok(config)
    }

    /// Refuses an ensemble other than the trained one, and keys that decide how it was trained.
    fn check_is_trained(
        &self,
        set: &BTreeMap<String, Value>,
        before: &BTreeMap<String, Value>,
    ) -> Result<(), Error> {
        let own = self.reward.model;
        let wanted =
            set.get("reward.model").and_then(Value::as_str).and_then(RewardModelKind::named);
        let model = wanted.unwrap_or(own);
        if !model.trains {
            return Ok(());
        }
        let expected =
            format!("{} or one that learns nothing, since no other is trained already", own.name);
        within("reward.model", model == own, &expected, model.name)?;
        for (key, value) in set.iter().filter(|(key, _)| !READ.contains(&key.as_str())) {
            if let Some(trained) = before.get(key) {
                let expected = format!("{trained}, with which the model is trained already");
                within(key, is_same(trained, value), &expected, value)?;
            }
        }
        Ok(())
    }
}
