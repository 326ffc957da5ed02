//! Recorded episodes re-simulated from their seeds and actions, many in parallel.

use anyhow::{Result, bail, ensure};
use protocol::task::{Spec, floats};
use protocol::trajectory::Trajectory;
use rayon::prelude::*;

use crate::episode::{Episode, EpisodeName, is_of_no_episode};
use crate::factory::Factory;

/// Number of episodes per thread that are re-simulated at once.
const CHUNK: usize = 64;

/// A re-simulator of recorded episodes with one setting.
pub(crate) struct Resimulator<'a> {
    threads: &'a rayon::ThreadPool,
    spec: Spec,
    actors: Vec<Actor>,
}

impl<'a> Resimulator<'a> {
    /// Creates an actor for each of the threads.
    ///
    /// # Errors
    /// When the environment cannot be made.
    pub(crate) fn new(threads: &'a rayon::ThreadPool, factory: &Factory) -> Result<Self> {
        let spec = factory.make()?.spec();
        let actor = || Actor { factory: factory.clone(), spec, episode: None };
        let actors = std::iter::repeat_with(actor).take(threads.current_num_threads()).collect();
        Ok(Resimulator { threads, spec, actors })
    }

    /// Returns the shapes of the task.
    pub(crate) fn spec(&self) -> Spec {
        self.spec
    }

    /// Returns the number of episodes that keeps all threads busy.
    pub(crate) fn episodes_at_once(&self) -> usize {
        CHUNK * self.actors.len()
    }

    /// Re-simulates the recorded episodes, and returns what `judge` makes of each recorded episode and its
    /// result, in order.
    pub(crate) fn each<T: Send>(
        &mut self,
        recorded: &[Trajectory],
        judge: impl Fn(&Trajectory, Result<Trajectory>) -> T + Sync,
    ) -> Vec<T> {
        let share = recorded.len().div_ceil(self.actors.len()).max(1);
        let shares = self.actors.par_iter_mut().zip(recorded.par_chunks(share));
        let of_share = |(actor, recorded): (&mut Actor, &[Trajectory])| -> Vec<T> {
            recorded.iter().map(|recorded| judge(recorded, actor.act(recorded))).collect()
        };
        self.threads.install(|| shares.flat_map_iter(of_share).collect())
    }
}

/// An actor that re-simulates episodes, one after another in one environment.
struct Actor {
    factory: Factory,
    spec: Spec,
    episode: Option<Episode>,
}

impl Actor {
    /// Re-simulates an episode; tries once more, in a new environment, after a failure for a reason outside the
    /// episode.
    fn act(&mut self, recorded: &Trajectory) -> Result<Trajectory> {
        match self.act_once(recorded) {
            Err(error) if is_of_no_episode(&error) => self.act_once(recorded),
            acted => acted,
        }
    }

    /// Re-simulates an episode once. An environment that has failed is not used again.
    fn act_once(&mut self, recorded: &Trajectory) -> Result<Trajectory> {
        let name = EpisodeName::of(recorded)?;
        let mut episode = self.factory.begin(name, self.episode.take())?;
        // The environment does not depend on the policy's log-probabilities, so they are copied.
        let mut log_probs = floats(&recorded.log_probs);
        for action in recorded.actions().chunks_exact(self.spec.action.bytes()) {
            if let Some(trajectory) = episode.step(action, log_probs.next())? {
                self.episode = Some(episode);
                return Ok(trajectory);
            }
        }
        ensure!(!recorded.actions().is_empty(), "expected actions to re-simulate, found none");
        bail!("expected to end after step {}, found it going on", recorded.steps)
    }
}
