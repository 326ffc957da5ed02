//! What the program that acts in a task says of it: `goalward-actor describe TASK`.

use serde::{Deserialize, Serialize};

use crate::setting::Setting;
use crate::task::Task;

/// A task, and settings made complete by its environment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Description {
    /// The task, without its program.
    pub task: Task,
    /// The setting asked for, with every key that the environment has.
    pub environment: Setting,
    /// The same of the setting that its expert demonstrates in.
    pub demonstrations: Setting,
    /// Whether the task comes with an expert.
    pub has_expert: bool,
}
