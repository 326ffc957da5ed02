//! The one error type of this crate; every message says what was expected and what was found.

/// What an environment refuses.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum EnvironmentError {
    /// A task that is not there.
    #[error("unknown task `{found}`; known tasks: {known}")]
    UnknownTask {
        /// The name given.
        found: String,
        /// The names there are.
        known: String,
    },
    /// A setting that the task does not have.
    #[error(transparent)]
    Setting(#[from] protocol::Error),
    /// A state with a number that is infinite or no number.
    #[error("expected finite numbers in the state, found {found} in {part} at step {step}")]
    StateNotFinite {
        /// The body or joint.
        part: &'static str,
        /// The number.
        found: f32,
        /// Steps taken in the episode.
        step: u32,
    },
    /// An action of the wrong length.
    #[error("expected an action of {expected} bytes, found {found} bytes")]
    ActionLength {
        /// Length of an action in bytes.
        expected: usize,
        /// Length of the action given in bytes.
        found: usize,
    },
    /// A discrete action that the task does not have.
    #[error("expected an action below {count}, found action {found}")]
    ActionUnknown {
        /// Number of actions.
        count: usize,
        /// The action given.
        found: u8,
    },
    /// A continuous action with a number that is infinite or no number.
    #[error("expected finite numbers in the action, found {found} at index {index}")]
    ActionNotFinite {
        /// Place of the number in the action.
        index: usize,
        /// The number given.
        found: f32,
    },
    /// A step before the first reset or after an episode's end.
    #[error("expected a reset before this step, no episode is running")]
    NotRunning,
    /// What an environment that is none of ours raised: in the same episode it would raise it again.
    #[error("{0}")]
    Raised(String),
    /// What an environment that is none of ours has to say that does not follow from the episode: tried again it
    /// may go well.
    #[error("{0}")]
    Other(String),
}
