//! Keys that a run does not read because of its task, its method or another key. A task's file may hold
//! them, since it serves all methods; a user who changes one by a setting is told that it has no effect. `steps` is
//! accepted with every method, since plans set it for all of theirs.

use std::collections::BTreeMap;

use protocol::Error;
use protocol::error::within;
use toml::{Table, Value};

use super::learner::is_of_learners;
use super::{Learner, RunConfig};

const NO_HIDDEN: &str = "this network has no hidden layers over a grid";
const NO_GRID: &str = "the task's observations are not a grid";
const DISCRETE: &str = "the task's actions are discrete";
const NO_DECAY: &str = "the learning rate does not decay";
const NO_STEPS: &str = "the learner takes no environment steps";
const TOLD: &str =
    "the environment tells when the agent arrives, unless reward.experience_after_goal = true";
const NO_GOAL: &str = "the task's episodes do not say when they reached the goal";

/// Returns whether a key belongs to the encoder of grids.
fn is_of_encoder(key: &str) -> bool {
    ["convolution_channels", "convolution_kernel", "pool", "features"].contains(&key)
}

/// Returns whether a configuration has a table only with a learner that reads it.
fn is_optional(table: &str) -> bool {
    is_of_learners(table) && table != "ppo"
}

/// Removes tables of other learners, which a task's file may have for those; removes none if the learner is unknown.
pub(super) fn leave_out_tables(learner: Option<Value>, table: &mut Table) {
    let Some(Ok(learner)) = learner.map(Value::try_into::<Learner>) else { return };
    table.retain(|name, _| !is_optional(name) || learner.tables().contains(&name));
}

/// Refuses keys in tables of other learners, which are complete only with those.
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
    /// Refuses keys that `set` changes from their value in `before` although the run does not read them.
    pub(super) fn check_all_is_read(
        &self,
        set: &BTreeMap<String, Value>,
        before: &BTreeMap<String, Value>,
    ) -> Result<(), Error> {
        for (key, value) in set {
            if before.get(key) != Some(value)
                && let Some(why) = self.why_unread(key)
            {
                within(key, false, &format!("left out: {why}"), value)?;
            }
        }
        Ok(())
    }

    /// Returns why the run does not read a key such as `ppo.clip`; `None` if it does.
    pub fn why_unread(&self, key: &str) -> Option<String> {
        key.split_once('.').and_then(|(table, name)| self.unread(table, name))
    }

    /// Returns why the run does not read a key of a table; `None` if it does.
    fn unread(&self, table: &str, name: &str) -> Option<String> {
        if let ("cloning", "patience", Some(why)) = (table, name, self.nothing_held_out()) {
            return Some(why);
        }
        let (grid, discrete) = (self.is_of_cells(), self.has_discrete_actions());
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
            ("demonstrations", "file") if !self.imitates() => "the method uses no demonstrations",
            ("reward", "experience_after_goal") if !self.task.tells_success => NO_GOAL,
            ("sqil", "agent_after_goal") if !self.task.tells_success => NO_GOAL,
            ("reward", "arrival") if self.reward.arrival > 0.0 && self.is_told_of_arrival() => TOLD,
            ("reward", name) => return self.reward.unread(name),
            (table, name) => return self.unread_of_learner(table, name),
        };
        Some(why.to_owned())
    }

    /// Returns whether the reward model gets the agent's states up to the goal only.
    fn is_told_of_arrival(&self) -> bool {
        self.task.tells_success && !self.reward.experience_after_goal
    }

    /// Returns why no demonstrations are held out from cloning; `None` if some are, or if the learner holds none out.
    fn nothing_held_out(&self) -> Option<String> {
        let reads = self.learner.reads(self, "cloning", "validation");
        let part = self.cloning.as_ref().filter(|_| reads)?.validation;
        let episodes = self.demonstrations.episodes;
        let why =
            || format!("cloning.validation = {part} holds out none of {episodes} demonstrations");
        ((part * episodes as f64) < 1.0).then(why)
    }

    fn unread_of_learner(&self, table: &str, name: &str) -> Option<String> {
        let read = !is_of_learners(table) || self.learner.reads(self, table, name);
        (!read).then(|| not_of_learner(self.learner))
    }
}
