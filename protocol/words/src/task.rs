//! The tasks and the shape of what flows between their environments and the networks (Table 1).
//!
//! An observation and an action are each a fixed number of bytes, laid out as [`ObservationSpec`]
//! and [`ActionSpec`] say. The same bytes are written by the environment, sent through shared
//! memory, kept in the log and read by the networks; nothing in between converts them.

use serde::{Deserialize, Serialize};

use crate::ending::Ending;

/// A task of the paper.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Task {
    /// Four rooms on a 19 x 19 grid (paper, Section 4.3).
    Navigation,
    /// A gripper lifts a cube to a goal in the air (Section 4.4).
    FetchPick,
    /// A gripper pushes a cube to a goal on the table (Section 4.4).
    FetchPush,
    /// A quadruped walks to a goal five meters away (Section 4.5).
    AntReach,
}

impl Task {
    /// Every task, in the order of the paper.
    pub const ALL: [Task; 4] = [Task::Navigation, Task::FetchPick, Task::FetchPush, Task::AntReach];

    /// The name users type and the log carries.
    pub fn name(self) -> &'static str {
        match self {
            Task::Navigation => "navigation",
            Task::FetchPick => "fetch-pick",
            Task::FetchPush => "fetch-push",
            Task::AntReach => "ant-reach",
        }
    }

    /// The shapes of the task (Table 1).
    pub fn spec(self) -> Spec {
        let (observation, action, horizon_steps) = match self {
            Task::Navigation => (
                ObservationSpec::Cells { height: 19, width: 19, classes: 4 },
                ActionSpec::Discrete { count: 4 },
                100,
            ),
            Task::FetchPick => {
                (ObservationSpec::Vector { len: 16 }, ActionSpec::Continuous { len: 4 }, 50)
            }
            Task::FetchPush => {
                (ObservationSpec::Vector { len: 16 }, ActionSpec::Continuous { len: 3 }, 60)
            }
            Task::AntReach => {
                (ObservationSpec::Vector { len: 132 }, ActionSpec::Continuous { len: 8 }, 50)
            }
        };
        Spec { task: self, observation, action, horizon_steps }
    }
}

impl std::str::FromStr for Task {
    type Err = crate::Error;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        Task::ALL.into_iter().find(|task| task.name() == name).ok_or_else(|| {
            let known: Vec<_> = Task::ALL.iter().map(|task| task.name()).collect();
            crate::Error::UnknownTask { found: name.to_owned(), known: known.join(", ") }
        })
    }
}

impl std::fmt::Display for Task {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str(self.name())
    }
}

/// What a task looks like from outside.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Spec {
    /// The task described.
    pub task: Task,
    /// Shape of one observation.
    pub observation: ObservationSpec,
    /// Shape of one action.
    pub action: ActionSpec,
    /// Longest episode, in environment steps.
    pub horizon_steps: u32,
}

impl Spec {
    /// How an episode ends after so many steps, if it does: at the goal, where the task ends
    /// there, or else at the horizon.
    pub fn ending(&self, at_goal: bool, steps: u32) -> Option<Ending> {
        if at_goal {
            return Some(Ending::Terminated);
        }
        (steps == self.horizon_steps).then_some(Ending::Truncated)
    }
}

/// Shape and layout of one observation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ObservationSpec {
    /// A grid of cell classes, one byte a cell, row by row. Networks see it as one-hot channels.
    Cells {
        /// Rows of the grid.
        height: usize,
        /// Columns of the grid.
        width: usize,
        /// Number of classes; each byte is below it.
        classes: usize,
    },
    /// Numbers, each a little-endian `f32`.
    Vector {
        /// How many numbers.
        len: usize,
    },
}

impl ObservationSpec {
    /// Length of one observation in bytes.
    pub fn bytes(&self) -> usize {
        match *self {
            ObservationSpec::Cells { height, width, .. } => height * width,
            ObservationSpec::Vector { len } => 4 * len,
        }
    }

    /// Checks that these are whole observations, with only classes there are, or only finite numbers.
    pub fn check(&self, observations: &[u8]) -> Result<(), crate::Error> {
        let refused = |what, expected: String, found: String| {
            Err(crate::Error::Trajectory { what, expected, found })
        };
        let (one, found) = (self.bytes(), observations.len());
        if !found.is_multiple_of(one) {
            return refused(
                "bytes of observations",
                format!("a multiple of {one}"),
                found.to_string(),
            );
        }
        match *self {
            ObservationSpec::Cells { classes, .. } => {
                match observations.iter().find(|&&class| usize::from(class) >= classes) {
                    Some(class) => {
                        refused("cell class", format!("below {classes}"), class.to_string())
                    }
                    None => Ok(()),
                }
            }
            ObservationSpec::Vector { .. } => {
                match floats(observations).find(|number| !number.is_finite()) {
                    Some(number) => {
                        refused("observation", "finite numbers".to_owned(), number.to_string())
                    }
                    None => Ok(()),
                }
            }
        }
    }

    /// Shape as the log states it: `[height, width]` or `[len]`.
    pub fn shape(&self) -> Vec<u32> {
        match *self {
            ObservationSpec::Cells { height, width, .. } => vec![height as u32, width as u32],
            ObservationSpec::Vector { len } => vec![len as u32],
        }
    }
}

/// Shape and layout of one action.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ActionSpec {
    /// One byte, below `count`.
    Discrete {
        /// Number of actions.
        count: usize,
    },
    /// Numbers, each a little-endian `f32`; the environment clips them to [-1, 1].
    Continuous {
        /// How many numbers.
        len: usize,
    },
}

impl ActionSpec {
    /// Length of one action in bytes.
    pub fn bytes(&self) -> usize {
        match *self {
            ActionSpec::Discrete { .. } => 1,
            ActionSpec::Continuous { len } => 4 * len,
        }
    }
}

/// Reads little-endian `f32` numbers out of observation or action bytes.
pub fn floats(bytes: &[u8]) -> impl ExactSizeIterator<Item = f32> + '_ {
    bytes.chunks_exact(4).map(|chunk| f32::from_le_bytes([chunk[0], chunk[1], chunk[2], chunk[3]]))
}

/// Writes `f32` numbers little-endian into observation or action bytes of exactly their length.
pub fn write_floats(numbers: impl IntoIterator<Item = f32>, bytes: &mut [u8]) {
    let mut chunks = bytes.chunks_exact_mut(4);
    for number in numbers {
        let chunk = chunks.next().expect("the caller sized the bytes by the spec");
        chunk.copy_from_slice(&number.to_le_bytes());
    }
}
