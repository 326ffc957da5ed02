//! Policy learners, as far as configurations, demonstrations and estimates need to know them
//! (Table 2; paper, Section 4.1 and Appendix F for the baselines). Each has its own file, which says
//! what it needs. Only the learner's process, which has a constructor for each name, knows how it learns.

mod bc;
mod bco;
mod ppo;
mod sqil;

use std::fmt;
use std::ops::Deref;

use protocol::Error;
use protocol::dropped::shortened;
use protocol::error::FOUND_CHARS;
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::RunConfig;
use super::estimate::{Memory, Work};
use crate::learning_rate::LearningRate;

pub use bc::CloningConfig;
pub use bco::InverseDynamicsConfig;
pub use ppo::PpoConfig;
pub use sqil::{AfterGoal, SqilConfig};

/// All policy learners.
pub const LEARNERS: &[&dyn LearnerRules] = &[&ppo::Ppo, &bc::Bc, &bco::Bco, &sqil::Sqil];

/// Returns whether a table belongs to learners: some of them read it.
pub(super) fn is_of_learners(table: &str) -> bool {
    LEARNERS.iter().any(|learner| learner.tables().contains(&table))
}

/// What a policy learner requires of a run. A policy learner and a reward model make a method.
pub trait LearnerRules: Sync {
    /// Returns its name in a configuration.
    fn name(&self) -> &'static str;

    /// Returns whether it learns from the rewards of a reward model.
    fn is_rewarded(&self) -> bool {
        false
    }

    /// Returns whether the learner itself learns from demonstrations.
    fn imitates(&self) -> bool {
        true
    }

    /// Returns whether it needs the actions of the demonstrations, too.
    fn needs_expert_actions(&self) -> bool {
        false
    }

    /// Returns whether it learns from batches of earlier iterations, which come from the log when a run is resumed.
    fn replays(&self) -> bool {
        false
    }

    /// Returns the tables of learners that it reads.
    fn tables(&self) -> &'static [&'static str];

    /// Returns whether it reads this key of a learner's table.
    fn reads(&self, config: &RunConfig, table: &str, key: &str) -> bool;

    /// Checks values that are valid one by one against each other.
    ///
    /// # Errors
    /// Names the first key that contradicts another.
    fn check(&self, _config: &RunConfig) -> Result<(), Error> {
        Ok(())
    }

    /// Checks that a run that is to be trained can learn something.
    ///
    /// # Errors
    /// As [`LearnerRules::check`].
    fn check_learning(&self, _config: &RunConfig) -> Result<(), Error> {
        Ok(())
    }

    /// Returns the learning rate of the policy.
    fn learning_rate(&self, config: &RunConfig) -> LearningRate;

    /// Returns whether it takes environment steps.
    fn acts(&self) -> bool {
        true
    }

    /// Returns the largest number of iterations that a run takes.
    fn iterations(&self, config: &RunConfig) -> u64 {
        config.steps.div_ceil(config.iteration_steps())
    }

    /// Returns what it holds in memory.
    fn memory(&self, config: &RunConfig) -> Memory;

    /// Returns what it computes over a run.
    fn work(&self, config: &RunConfig) -> Work;
}

/// A policy learner, identified by its name.
#[derive(Clone, Copy)]
pub struct Learner(&'static dyn LearnerRules);

impl Deref for Learner {
    type Target = dyn LearnerRules;

    fn deref(&self) -> &Self::Target {
        self.0
    }
}

impl PartialEq for Learner {
    fn eq(&self, other: &Self) -> bool {
        self.name() == other.name()
    }
}

impl fmt::Debug for Learner {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.name())
    }
}

impl Serialize for Learner {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}

impl<'de> Deserialize<'de> for Learner {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let name = String::deserialize(deserializer)?;
        let found = LEARNERS.iter().find(|learner| learner.name() == name);
        found.map(|learner| Learner(*learner)).ok_or_else(|| {
            let known: Vec<_> = LEARNERS.iter().map(|learner| learner.name()).collect();
            let (found, known) = (shortened(&name, FOUND_CHARS), known.join(", "));
            D::Error::custom(format!("unknown learner `{found}`, expected one of {known}"))
        })
    }
}
