//! The error type of this crate; every message says what was expected and what was found.

/// An error of an environment.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum EnvironmentError {
    /// The task does not exist.
    #[error("unknown task `{found}`; known tasks: {known}")]
    UnknownTask {
        /// The name that was given.
        found: String,
        /// The names of the known tasks.
        known: String,
    },
    /// The task does not accept the setting.
    #[error(transparent)]
    Setting(#[from] protocol::Error),
    /// The state has a number that is infinite or NaN.
    #[error("expected finite numbers in the state, found {found} in {part} at step {step}")]
    StateNotFinite {
        /// The body with that number, or whose joint has it.
        part: &'static str,
        /// The number.
        found: f32,
        /// Number of steps taken in the episode.
        step: u32,
    },
    /// The action has the wrong length.
    #[error("expected an action of {expected} bytes, found {found} bytes")]
    ActionLength {
        /// Expected length of an action, bytes.
        expected: usize,
        /// Length of the given action, bytes.
        found: usize,
    },
    /// The task does not have this discrete action.
    #[error("expected an action below {count}, found action {found}")]
    ActionUnknown {
        /// Number of actions.
        count: usize,
        /// The given action.
        found: u8,
    },
    /// The continuous action has a number that is infinite or NaN.
    #[error("expected finite numbers in the action, found {found} at index {index}")]
    ActionNotFinite {
        /// Index of the number in the action.
        index: usize,
        /// The number.
        found: f32,
    },
    /// A step was asked for before the first reset or after the end of an episode.
    #[error("expected a reset before this step, no episode is running")]
    NotRunning,
    /// An external environment raised an error; the same episode would raise it again.
    #[error("{0}")]
    Raised(String),
    /// An external environment failed for a reason that does not follow from the episode; another try may succeed.
    #[error("{0}")]
    Other(String),
}
