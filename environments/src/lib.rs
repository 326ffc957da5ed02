//! The tasks of the paper and their scripted or trained experts.
//!
//! An environment is a pure function of its state and an action. It has no clock, no thread, no file and no randomness
//! except the [`Stream`] passed to `reset`: the same stream and the same actions give the same bytes on every machine.
//! Observations and actions are bytes laid out as in [`protocol::task`]. An environment writes them into buffers of
//! the caller, and our own code allocates nothing in a step.
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

pub use action::{ActionScale, check_action};
pub use error::EnvironmentError;
pub use protocol::setting::Setting;
pub use registration::{BUILT_IN, Expert, Registration, create, find};
pub use scene::{Pose, Shape, Solid};

use protocol::ending::Ending;
use protocol::seed::Stream;
use protocol::task::Spec;

/// A task in which an agent or an expert acts, one episode after another.
pub trait Environment: Send {
    /// Returns the shapes of the task.
    fn spec(&self) -> Spec;

    /// Returns the setting that the environment was made with, completed by the defaults.
    fn setting(&self) -> Setting;

    /// Returns names for the classes of cells or the numbers of an observation vector; empty if none are known.
    fn labels(&self) -> Vec<String> {
        Vec::new()
    }

    /// Returns whether episodes report if they reached the goal ([`Step::success`]).
    fn tells_success(&self) -> bool {
        true
    }

    /// Begins an episode drawn from `stream` and writes its first observation.
    ///
    /// Earlier episodes leave no trace: an episode depends only on the stream and its actions.
    ///
    /// # Errors
    /// When the physics does not give a finite first state.
    ///
    /// # Panics
    /// When `observation` is not exactly as long as the spec says.
    fn reset(
        &mut self,
        stream: &mut Stream,
        observation: &mut [u8],
    ) -> Result<(), EnvironmentError>;

    /// Announces the action of the next call of [`Environment::step`]. An environment in another process can then step
    /// several lanes in parallel; other environments ignore the call.
    ///
    /// # Errors
    /// As [`Environment::step`].
    fn announce(&mut self, _action: &[u8]) -> Result<(), EnvironmentError> {
        Ok(())
    }

    /// Takes one action and writes the observation that follows, also at the end of an episode.
    ///
    /// # Errors
    /// When the action does not fit the spec (its length, a discrete action that does not exist, a number that is not
    /// finite), when no episode is running, or when the physics gives a state that is not finite. A refused action
    /// changes nothing.
    ///
    /// # Panics
    /// When `observation` is not exactly as long as the spec says.
    fn step(&mut self, action: &[u8], observation: &mut [u8]) -> Result<Step, EnvironmentError>;

    /// Writes the action that the scripted expert takes in the current state.
    ///
    /// Returns false, and writes nothing, if there is no such action: the task has no scripted expert, no episode is
    /// running, or the expert has arrived and has nothing left to do.
    ///
    /// # Errors
    /// When the script fails; the scripts of this crate never do.
    ///
    /// # Panics
    /// When `action` is not exactly as long as the spec says.
    fn expert_action(&mut self, _action: &mut [u8]) -> Result<bool, EnvironmentError> {
        Ok(false)
    }

    /// Returns a hash of the exact state (ours use xxh3): two environments with the same hash respond to the same
    /// actions with the same bytes. A replay compares the hash with the recorded one.
    fn state_hash(&self) -> u64;

    /// Returns the solids that a viewer draws, which never change; empty for a task without physics.
    fn solids(&self) -> &[Solid] {
        &[]
    }

    /// Appends the current pose of every solid, in the order of [`Environment::solids`].
    fn append_poses(&self, _poses: &mut Vec<Pose>) {}

    /// Renders the current state as a PNG file; `None` if the environment does not render, or was made without
    /// rendering.
    ///
    /// # Errors
    /// When rendering fails.
    fn picture(&mut self) -> Result<Option<Vec<u8>>, EnvironmentError> {
        Ok(None)
    }
}

/// The result of a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// The environment's own reward. Imitation learning never sees it; trained experts learn from it.
    pub reward: f32,
    /// How the episode ended, if this step ended it.
    pub ending: Option<Ending>,
    /// Whether the goal has been reached in this episode so far. In some tasks the episode goes on.
    pub success: bool,
}
