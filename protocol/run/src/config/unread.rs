//! Keys that a run reads nowhere, because of its task, its method or another key. A task's file holds
//! every key, so they may stand there; whoever changes one on purpose is told that nothing follows.

use std::collections::BTreeMap;

use protocol::Error;
use protocol::error::within;
use toml::Value;

use super::learner::is_of_learners;
use super::{Learner, RunConfig};

const NO_HIDDEN: &str = "the policy has no hidden layers over a grid";
const NO_GRID: &str = "the task's observations are no grid";
const DISCRETE: &str = "the task's actions are discrete";
const NO_DECAY: &str = "the learning rate does not fall";
const NO_STEPS: &str = "the learner takes no environment steps";
const NOTHING_HELD_OUT: &str = "with cloning.validation = 0 nothing is held out";

/// Whether a key is one of the encoder of grids.
fn is_of_encoder(key: &str) -> bool {
    ["convolution_channels", "convolution_kernel", "pool", "features"].contains(&key)
}

/// Whether a configuration has a table only with a learner that reads it.
fn is_optional(table: &str) -> bool {
    is_of_learners(table) && table != "ppo"
}

/// Refuses keys in tables of other learners, which are whole only with those.
pub(super) fn check_tables(learner: Learner, set: &BTreeMap<String, Value>) -> Result<(), Error> {
    for (key, value) in set {
        let table = key.split_once('.').map_or("", |(table, _)| table);
        let of_others = is_optional(table) && !learner.tables().contains(&table);
        within(key, !of_others, &format!("left out: {}", not_of_learner(learner)), value)?;
    }
    Ok(())
}

fn not_of_learner(learner: Learner) -> String {
    format!("the learner {} does not read it", learner.name())
}

impl RunConfig {
    /// Refuses what `set` changes of the values in `before` without any effect.
    pub(super) fn check_all_is_read(
        &self,
        set: &BTreeMap<String, Value>,
        before: &BTreeMap<String, Value>,
    ) -> Result<(), Error> {
        for (key, value) in set {
            if before.get(key) != Some(value)
                && let Some((table, name)) = key.split_once('.')
                && let Some(why) = self.unread(table, name)
            {
                within(key, false, &format!("left out: {why}"), value)?;
            }
        }
        Ok(())
    }

    /// Why the run reads this key nowhere; none if it does.
    fn unread(&self, table: &str, name: &str) -> Option<String> {
        let (grid, discrete) = (self.is_of_cells(), self.acts_by_choice());
        let why = match (table, name) {
            ("policy", "hidden" | "activation") if grid => NO_HIDDEN,
            ("policy", "distribution") | ("cloning", "deviations") if discrete => DISCRETE,
            ("policy", "shared_trunk") if !grid => NO_GRID,
            ("policy" | "reward" | "inverse_dynamics", key) if !grid && is_of_encoder(key) => {
                NO_GRID
            }
            ("inverse_dynamics", "hidden") if grid => NO_HIDDEN,
            ("sqil", "hidden" | "tune_temperature") if discrete => DISCRETE,
            ("ppo", "decay_steps") if !self.ppo.learning_rate_decay => NO_DECAY,
            ("reward", "decay_steps") if !self.reward.learning_rate_decay => NO_DECAY,
            ("rollout", "lag" | "lane_steps") if !self.learner.acts() => NO_STEPS,
            ("cloning", "patience") if self.holds_nothing_out() => NOTHING_HELD_OUT,
            ("demonstrations", "file") if !self.imitates() => "the method learns from none",
            ("reward", name) => return self.reward.unread(name),
            (table, name) => return self.unread_of_learner(table, name),
        };
        Some(why.to_owned())
    }

    /// Whether what is cloned could be held out, and is not.
    fn holds_nothing_out(&self) -> bool {
        let reads = self.learner.reads(self, "cloning", "validation");
        reads && self.cloning.as_ref().is_some_and(|cloning| cloning.validation == 0.0)
    }

    fn unread_of_learner(&self, table: &str, name: &str) -> Option<String> {
        let read = !is_of_learners(table) || self.learner.reads(self, table, name);
        (!read).then(|| not_of_learner(self.learner))
    }
}
