//! Who holds the lock of a run's folder. The process that takes the lock writes this into the lock file.

use serde::{Deserialize, Serialize};

/// What a process does that holds the lock of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Work {
    /// It trains the run.
    #[default]
    Training,
    /// It acts for a run on another machine.
    Joining,
    /// It publishes the recorded trajectories again.
    Publishing,
    /// It seals files of the log.
    Repairing,
    /// It removes what an earlier process left.
    CleaningUp,
}

impl Work {
    /// Returns what happens to the run, after "is being".
    pub fn done_to_it(self) -> &'static str {
        match self {
            Work::Training => "trained",
            Work::Joining => "joined",
            Work::Publishing => "published",
            Work::Repairing => "repaired",
            Work::CleaningUp => "cleaned up",
        }
    }
}

/// A process that holds or held the lock of a run. What an earlier build wrote is empty.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Holder {
    /// What it does.
    pub work: Work,
    /// Its id on its machine.
    pub process: Option<u32>,
    /// Name of its machine.
    pub machine: String,
    /// Why its work failed, as its user was told.
    pub failure: Option<String>,
}

impl Holder {
    /// Parses the content of a lock file.
    pub fn from_text(text: &str) -> Holder {
        serde_json::from_str(text).unwrap_or_default()
    }

    /// Returns which process this is, as people read it.
    pub fn shown(&self) -> String {
        match self.process {
            Some(process) => format!("process {process} on {}", self.machine),
            None => "a process of an earlier build".to_owned(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lock_file_without_a_holder_is_that_of_a_training() {
        for text in ["", "{", "12"] {
            assert_eq!(Holder::from_text(text), Holder::default());
        }
        assert_eq!(Holder::default().work, Work::Training);
    }
}
