//! Keys that a run reads nowhere, because of its task, its method or another key. A task's file holds
//! every key, so they may stand there; whoever changes one on purpose is told that nothing follows.

use std::collections::BTreeMap;

use protocol::Error;
use protocol::error::within;
use protocol::task::ObservationSpec;
use toml::Value;

use super::{Learner, RunConfig};

const NO_HIDDEN: &str = "the policy has no hidden layers over a grid";
const NO_GRID: &str = "the task's observations are no grid";
const DISCRETE: &str = "the task's actions are discrete";
const NO_DECAY: &str = "the learning rate does not fall";

/// Refuses keys in tables of other learners, which come with their methods and are whole only then.
pub(super) fn check_tables(learner: Learner, set: &BTreeMap<String, Value>) -> Result<(), Error> {
    for (key, value) in set {
        let has_table = key.split_once('.').is_none_or(|(table, _)| learner.has_table(table));
        within(key, has_table, &format!("left out: {}", not_of_learner(learner)), value)?;
    }
    Ok(())
}

fn not_of_learner(learner: Learner) -> String {
    format!("the learner {} does not read it", learner.name())
}

impl Learner {
    /// Whether a configuration with this learner has this table.
    fn has_table(self, table: &str) -> bool {
        match table {
            "cloning" => matches!(self, Learner::Bc | Learner::Bco),
            "inverse_dynamics" => self == Learner::Bco,
            "sqil" => self == Learner::Sqil,
            _ => true,
        }
    }
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
        let grid = matches!(self.task.spec().observation, ObservationSpec::Cells { .. });
        let why = match (table, name) {
            ("policy", "hidden" | "activation") if grid => NO_HIDDEN,
            ("policy", "distribution") if grid => DISCRETE,
            ("policy", "convolution_channels" | "features" | "shared_trunk") if !grid => NO_GRID,
            ("reward" | "inverse_dynamics", "convolution_channels" | "features") if !grid => {
                NO_GRID
            }
            ("inverse_dynamics", "hidden") if grid => NO_HIDDEN,
            ("sqil", "hidden" | "tune_temperature") if grid => DISCRETE,
            ("ppo", "decay_steps") if !self.ppo.learning_rate_decay => NO_DECAY,
            ("reward", "decay_steps") if !self.reward.learning_rate_decay => NO_DECAY,
            ("demonstrations", "file") if !self.imitates() => "the method learns from none",
            ("reward", name) => return self.reward.model.unread(name),
            (table, name) => return self.unread_of_learner(table, name, grid),
        };
        Some(why.to_owned())
    }

    fn unread_of_learner(&self, table: &str, name: &str, grid: bool) -> Option<String> {
        let read = match (table, self.learner) {
            ("ppo", Learner::Ppo) => true,
            // What soft Q-learning of discrete actions has of PPO's optimizer.
            ("ppo", Learner::Sqil) => grid && ["adam_epsilon", "max_gradient_norm"].contains(&name),
            ("ppo", Learner::Bc | Learner::Bco) => false,
            ("cloning", Learner::Bco) => !["validation", "patience"].contains(&name),
            _ => self.learner.has_table(table),
        };
        (!read).then(|| not_of_learner(self.learner))
    }
}
