//! The tasks of the paper and their experts, where every trajectory begins.
//!
//! An environment is a pure function of its state and an action. It has no clock, no thread, no file
//! and no randomness but the [`Stream`] handed to `reset`: the same stream and the same actions give
//! the same bytes on every machine. Observations and actions are bytes laid out as
//! [`protocol::task`] says; an environment writes them where the caller keeps them, and nothing of
//! ours allocates in a step.
//!
//! ```
//! use environments::{Setting, create};
//! use protocol::seed::{Purpose, stream};
//!
//! let mut environment = create("navigation", &Setting::default())?;
//! let spec = environment.spec();
//! let mut observation = vec![0; spec.observation.bytes()];
//! let mut action = vec![0; spec.action.bytes()];
//! environment.reset(&mut stream(1, Purpose::Demonstration, 0, 0), &mut observation)?;
//! let last = loop {
//!     assert!(environment.expert_action(&mut action)?);
//!     let step = environment.step(&action, &mut observation)?;
//!     if step.ending.is_some() {
//!         break step;
//!     }
//! };
//! assert!(last.success);
//! # Ok::<(), environments::EnvironmentError>(())
//! ```

mod action;
pub mod ant;
mod error;
pub mod fetch;
pub mod navigation;
mod physics;
mod registration;
mod scene;

pub use action::{Scale as ActionScale, accept as check_action};
pub use error::EnvironmentError;
pub use protocol::setting::Setting;
pub use registration::{BUILT_IN, Expert, Registration, create, find};
pub use scene::{Pose, Shape, Solid};

use protocol::ending::Ending;
use protocol::seed::Stream;
use protocol::task::Spec;

/// A task as an agent or an expert acts in it, one episode after another.
pub trait Environment: Send {
    /// The shapes of the task.
    fn spec(&self) -> Spec;

    /// What it was made with, every key included that it has by default.
    fn setting(&self) -> Setting;

    /// What each class of cells is, or each number of a vector; empty where nobody says.
    fn labels(&self) -> Vec<String> {
        Vec::new()
    }

    /// Whether its episodes say if they reached the goal ([`Step::success`]).
    fn tells_success(&self) -> bool {
        true
    }

    /// Begins an episode drawn from `stream` and writes its first observation.
    ///
    /// Whatever came before leaves no trace: an episode depends on the stream and its actions alone.
    ///
    /// # Errors
    /// When the physics does not settle into a finite first state.
    ///
    /// # Panics
    /// When `observation` is not exactly as long as the spec says.
    fn reset(
        &mut self,
        stream: &mut Stream,
        observation: &mut [u8],
    ) -> Result<(), EnvironmentError>;

    /// Tells the environment of the action of its next step, which follows. An environment that lives
    /// elsewhere can take the steps of several lanes side by side then; others have no use for it.
    ///
    /// # Errors
    /// As [`Environment::step`].
    fn announce(&mut self, _action: &[u8]) -> Result<(), EnvironmentError> {
        Ok(())
    }

    /// Takes one action and writes the observation it leads to, the last one of an episode included.
    ///
    /// # Errors
    /// When the action does not fit the spec (its length, a discrete action that does not exist, a
    /// number that is not finite), when no episode is running, or when the physics leaves the finite
    /// numbers. A refused action changes nothing.
    ///
    /// # Panics
    /// When `observation` is not exactly as long as the spec says.
    fn step(&mut self, action: &[u8], observation: &mut [u8]) -> Result<Step, EnvironmentError>;

    /// Writes the action the scripted expert takes in the present state.
    ///
    /// Returns false, and writes nothing, where there is no such action: the task has no scripted
    /// expert, no episode is running, or the expert has arrived and has nothing left to do.
    ///
    /// # Errors
    /// When the script fails; those of this crate never do.
    ///
    /// # Panics
    /// When `action` is not exactly as long as the spec says.
    fn expert_action(&mut self, _action: &mut [u8]) -> Result<bool, EnvironmentError> {
        Ok(false)
    }

    /// The xxh3 hash of the exact state: two environments with the same hash answer the same actions
    /// with the same bytes. A replay compares it with the recorded one.
    fn state_hash(&self) -> u64;

    /// The solids that a viewer draws, always the same; none for a task without physics.
    fn solids(&self) -> &[Solid] {
        &[]
    }

    /// Appends the present pose of every solid, in the order of [`Environment::solids`].
    fn append_poses(&self, _poses: &mut Vec<Pose>) {}

    /// A picture of the present state, a PNG file; none where the environment renders none, or has not been
    /// made to.
    ///
    /// # Errors
    /// When it cannot be rendered.
    fn picture(&mut self) -> Result<Option<Vec<u8>>, EnvironmentError> {
        Ok(None)
    }
}

/// What a step did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// The environment's own reward. Imitation never sees it; it trains experts.
    pub reward: f32,
    /// How the episode ended, if this step ended it.
    pub ending: Option<Ending>,
    /// Whether the goal has been reached in this episode so far. It does not end every task.
    pub success: bool,
}
