//! Policy learners, as far as configurations, demonstrations and estimates have to know them (Table 2;
//! paper, Section 4.1 and Appendix F for the baselines). Each says in a file of its own what it needs;
//! how it learns only the learner's process knows, which has a constructor for each name.

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

/// The policy learners there are.
pub const LEARNERS: &[&dyn LearnerRules] = &[&ppo::Ppo, &bc::Bc, &bco::Bco, &sqil::Sqil];

/// Whether a table is one of learners, each of which is read by some.
pub(super) fn is_of_learners(table: &str) -> bool {
    LEARNERS.iter().any(|learner| learner.tables().contains(&table))
}

/// What a policy learner asks of a run. With a reward model it makes a method.
pub trait LearnerRules: Sync {
    /// Its name in a configuration.
    fn name(&self) -> &'static str;

    /// Whether it learns from the rewards of a reward model.
    fn is_rewarded(&self) -> bool {
        false
    }

    /// Whether it learns from demonstrations itself.
    fn imitates(&self) -> bool {
        true
    }

    /// Whether it needs the actions of the demonstrations, too.
    fn needs_expert_actions(&self) -> bool {
        false
    }

    /// Whether it learns from batches of earlier iterations, which come from the log when a run is
    /// continued.
    fn replays(&self) -> bool {
        false
    }

    /// The tables of learners that it reads.
    fn tables(&self) -> &'static [&'static str];

    /// Whether it reads this key of a learner's table.
    fn reads(&self, config: &RunConfig, table: &str, key: &str) -> bool;

    /// Checks what its own values do not say one by one.
    ///
    /// # Errors
    /// Names the first key that contradicts another.
    fn check(&self, _config: &RunConfig) -> Result<(), Error> {
        Ok(())
    }

    /// Checks that a run that is to be trained learns something.
    ///
    /// # Errors
    /// As [`LearnerRules::check`].
    fn check_learning(&self, _config: &RunConfig) -> Result<(), Error> {
        Ok(())
    }

    /// The learning rate of the policy.
    fn learning_rate(&self, config: &RunConfig) -> LearningRate;

    /// Whether it takes environment steps.
    fn acts(&self) -> bool {
        true
    }

    /// Iterations that a run takes, at most.
    fn iterations(&self, config: &RunConfig) -> u64 {
        config.steps.div_ceil(config.iteration_steps())
    }

    /// What it holds in memory.
    fn memory(&self, config: &RunConfig) -> Memory;

    /// What it computes over a run.
    fn work(&self, config: &RunConfig) -> Work;
}

/// A policy learner, by its name.
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
