//! A task as everything but its environment sees it: a name, and the shapes of what passes between environment and
//! networks (Table 1).
//!
//! An observation and an action are each a fixed number of bytes, laid out as [`ObservationSpec`]
//! and [`ActionSpec`] say. The same bytes are written by the environment, sent through shared
//! memory, kept in the log and read by the networks; nothing in between converts them.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use crate::Error;
use crate::ending::Ending;
use crate::error::within;

/// A task as it is stored in configurations and logs: what programs that do not act in it need to know.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Task {
    /// Name of the task: letters, digits, `-`, `_` and `.`, the first not `.`.
    pub name: String,
    /// Shape of one observation.
    pub observation: ObservationSpec,
    /// Shape of one action.
    pub action: ActionSpec,
    /// Maximum length of an episode, in environment steps.
    pub horizon_steps: u32,
    /// Names of the cell classes, or of the elements of a vector; empty if unknown.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub labels: Vec<String>,
    /// Whether an episode depends only on its seed and its actions, so that it can be acted again.
    #[serde(default = "yes", skip_serializing_if = "is_yes")]
    pub deterministic: bool,
    /// Whether episodes report success. If not, the steps to the goal in demonstrations are counted from the last
    /// state, and a run is judged by return and proximity.
    #[serde(default = "yes", skip_serializing_if = "is_yes")]
    pub tells_success: bool,
    /// The program that acts in the task; `goalward-actor` if absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub program: Option<PathBuf>,
    /// SHA-256 of that program, which affects results. It is computed when a run begins.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub program_sha256: Option<String>,
}

fn yes() -> bool {
    true
}

fn is_yes(found: &bool) -> bool {
    *found
}

/// Maximum length of a task's name, in characters.
const NAME_CHARS: usize = 64;

/// Maximum size of an observation, in bytes.
const OBSERVATION_BYTES: usize = 1 << 20;

impl Task {
    /// Returns the shapes of the task (Table 1).
    pub fn spec(&self) -> Spec {
        let &Task { observation, action, horizon_steps, .. } = self;
        Spec { observation, action, horizon_steps }
    }

    /// Checks that networks and logs can handle the task.
    ///
    /// # Errors
    /// Names the first key that is out of range.
    pub fn check(&self) -> Result<(), Error> {
        let name = &self.name;
        let is_plain = |letter: char| letter.is_ascii_alphanumeric() || "-_.".contains(letter);
        let fits = (1..=NAME_CHARS).contains(&name.len());
        let plain = fits && name.chars().all(is_plain) && !name.starts_with('.');
        let expected = "up to 64 letters, digits, `-`, `_` and `.`, the first not `.`";
        within("task.name", plain, expected, format!("`{name}`"))?;
        if let ObservationSpec::Cells { classes, .. } = self.observation {
            let holds = (1..=256).contains(&classes);
            within("task.observation", holds, "of 1 to 256 classes", classes)?;
        }
        let parts = self.observation.parts();
        let labeled = self.labels.is_empty() || self.labels.len() == parts;
        let expected = format!("none, or {parts}, as the observation has classes or numbers");
        within("task.labels", labeled, &expected, self.labels.len())?;
        let bytes = self.observation.checked_bytes();
        let fits = bytes.is_some_and(|bytes| (1..=OBSERVATION_BYTES).contains(&bytes));
        let found = || bytes.map_or("more".to_owned(), |bytes| bytes.to_string());
        within("task.observation", fits, "1 byte to 1 MiB large", found())?;
        let (count, expected) = match self.action {
            ActionSpec::Discrete { count } => (count, "1 to 256 actions"),
            ActionSpec::Continuous { len } => (len, "1 to 256 numbers"),
        };
        within("task.action", (1..=256).contains(&count), expected, count)?;
        let horizon = self.horizon_steps;
        within("task.horizon_steps", (1..=1_000_000).contains(&horizon), "1 to 1000000", horizon)
    }
}

impl std::fmt::Display for Task {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str(&self.name)
    }
}

/// The shapes of a task.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Spec {
    /// Shape of one observation.
    pub observation: ObservationSpec,
    /// Shape of one action.
    pub action: ActionSpec,
    /// Maximum length of an episode, in environment steps.
    pub horizon_steps: u32,
}

impl Spec {
    /// Returns the shapes as text, each with its key in a task's table.
    pub fn named(&self) -> [(&'static str, String); 3] {
        [
            ("observation", format!("{:?}", self.observation)),
            ("action", format!("{:?}", self.action)),
            ("horizon_steps", self.horizon_steps.to_string()),
        ]
    }

    /// Returns how an episode ends after `steps` steps: at the goal if the task ends there, as `at_goal` says, else at
    /// the horizon; `None` if it goes on.
    pub fn ending(&self, at_goal: bool, steps: u32) -> Option<Ending> {
        if at_goal {
            return Some(Ending::GoalReached);
        }
        (steps == self.horizon_steps).then_some(Ending::Truncated)
    }
}

/// Shape and layout of one observation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
pub enum ObservationSpec {
    /// A grid of cell classes, one byte per cell, row by row. Networks see it as one-hot channels.
    Cells {
        /// Rows of the grid.
        height: usize,
        /// Columns of the grid.
        width: usize,
        /// Number of classes; each byte is less than this.
        classes: usize,
    },
    /// Numbers, each a little-endian `f32`.
    Vector {
        /// Number of elements.
        len: usize,
    },
}

impl ObservationSpec {
    /// Returns the length of one observation in bytes.
    pub fn bytes(&self) -> usize {
        match *self {
            ObservationSpec::Cells { height, width, .. } => height * width,
            ObservationSpec::Vector { len } => 4 * len,
        }
    }

    /// Returns the number of cell classes, or of vector elements.
    fn parts(&self) -> usize {
        match *self {
            ObservationSpec::Cells { classes, .. } => classes,
            ObservationSpec::Vector { len } => len,
        }
    }

    /// Returns how many numbers of an observation are normalized if that is wanted: none of a grid's.
    pub fn normalized(&self, wanted: bool) -> usize {
        match *self {
            ObservationSpec::Vector { len } if wanted => len,
            _ => 0,
        }
    }

    /// Returns the length of one observation in bytes; `None` if it overflows.
    fn checked_bytes(&self) -> Option<usize> {
        match *self {
            ObservationSpec::Cells { height, width, .. } => height.checked_mul(width),
            ObservationSpec::Vector { len } => len.checked_mul(4),
        }
    }

    /// Checks that the bytes are whole observations, with only valid classes or only finite numbers.
    ///
    /// # Errors
    /// [`Error::Trajectory`] for the first part that does not fit.
    pub fn check(&self, observations: &[u8]) -> Result<(), Error> {
        let refused = |what, expected: String, found: String| {
            Err(Error::Trajectory { what, expected, found })
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

    /// Returns the shape as recorded in the log: `[height, width]` or `[len]`.
    pub fn shape(&self) -> Vec<u32> {
        match *self {
            ObservationSpec::Cells { height, width, .. } => vec![height as u32, width as u32],
            ObservationSpec::Vector { len } => vec![len as u32],
        }
    }
}

/// Shape and layout of one action.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
pub enum ActionSpec {
    /// One byte, less than `count`.
    Discrete {
        /// Number of actions.
        count: usize,
    },
    /// Numbers, each a little-endian `f32`; the environment clips them to [-1, 1].
    Continuous {
        /// Number of elements.
        len: usize,
    },
}

impl ActionSpec {
    /// Returns the length of one action in bytes.
    pub const fn bytes(&self) -> usize {
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
