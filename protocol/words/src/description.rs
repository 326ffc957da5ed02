//! What the program that acts in a task says about it: `goalward-actor describe TASK`.

use serde::{Deserialize, Serialize};

use crate::setting::Setting;
use crate::task::Task;

/// A task, with settings that its environment has completed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Description {
    /// The task, without its program.
    pub task: Task,
    /// The requested setting, with every key that the environment has.
    pub environment: Setting,
    /// The setting in which its expert demonstrates, completed in the same way.
    pub demonstrations: Setting,
    /// Whether the task comes with an expert.
    pub has_expert: bool,
}
