//! The one error type of this crate; every message says what was expected and what was found.

use protocol::task::Task;

/// What an environment refuses.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum EnvironmentError {
    /// A setting whose coverage is no fraction, or leaves too few cells for a start and a goal.
    #[error(
        "{task}: coverage {found} must lie in (0, 1] and leave at least {cells_min} cells, it leaves {cells}"
    )]
    Coverage {
        /// The task asked for.
        task: Task,
        /// The coverage given.
        found: f64,
        /// The cells that it leaves.
        cells: usize,
        /// The fewest cells that will do.
        cells_min: usize,
    },
    /// A setting that the task does not have.
    #[error(transparent)]
    Setting(#[from] protocol::Error),
    /// A state with a number that is infinite or no number.
    #[error("{task}: expected finite numbers in the state, found {found} in {part} at step {step}")]
    StateNotFinite {
        /// The task.
        task: Task,
        /// The body or joint.
        part: &'static str,
        /// The number.
        found: f32,
        /// Steps taken in the episode.
        step: u32,
    },
    /// An action of the wrong length.
    #[error("{task}: expected an action of {expected} bytes, found {found} bytes")]
    ActionLength {
        /// The task acted in.
        task: Task,
        /// Length of an action in bytes.
        expected: usize,
        /// Length of the action given in bytes.
        found: usize,
    },
    /// A discrete action that the task does not have.
    #[error("{task}: expected an action below {count}, found action {found}")]
    ActionUnknown {
        /// The task acted in.
        task: Task,
        /// Number of actions.
        count: usize,
        /// The action given.
        found: u8,
    },
    /// A continuous action with a number that is infinite or no number.
    #[error("{task}: expected finite numbers in the action, found {found} at index {index}")]
    ActionNotFinite {
        /// The task acted in.
        task: Task,
        /// Place of the number in the action.
        index: usize,
        /// The number given.
        found: f32,
    },
    /// A step before the first reset or after an episode's end.
    #[error("{task}: expected a reset before this step, no episode is running")]
    NotRunning {
        /// The task acted in.
        task: Task,
    },
}
