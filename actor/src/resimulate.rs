//! Recorded episodes acted again, from their seeds and actions, many at a time.

use anyhow::{Result, bail, ensure};
use protocol::task::{Spec, floats};
use protocol::trajectory::{Source, Trajectory};
use rayon::prelude::*;

use crate::episode::{Episode, EpisodeName, is_of_no_episode};
use crate::factory::Factory;

/// Episodes that a thread acts before the next ones are asked for.
const CHUNK: usize = 64;

/// Acts recorded episodes of one setting again.
pub struct Resimulator<'a> {
    threads: &'a rayon::ThreadPool,
    spec: Spec,
    actors: Vec<Actor>,
}

impl<'a> Resimulator<'a> {
    /// An actor for each of the threads.
    ///
    /// # Errors
    /// When there is no such environment.
    pub fn new(threads: &'a rayon::ThreadPool, factory: &Factory) -> Result<Self> {
        let spec = factory.make()?.spec();
        let actor = || Actor { factory: factory.clone(), spec, episode: None };
        let actors = std::iter::repeat_with(actor).take(threads.current_num_threads()).collect();
        Ok(Resimulator { threads, spec, actors })
    }

    /// Shapes of the task.
    pub fn spec(&self) -> Spec {
        self.spec
    }

    /// Episodes that keep all threads busy.
    pub fn episodes_at_once(&self) -> usize {
        CHUNK * self.actors.len()
    }

    /// What `judge` says of each recorded episode and what came out when it was acted again.
    pub fn each<T: Send>(
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

/// Acts recorded episodes, one after another in one environment.
struct Actor {
    factory: Factory,
    spec: Spec,
    episode: Option<Episode>,
}

impl Actor {
    /// Acts an episode; once more in a new environment where it has failed for what is none of its own.
    fn act(&mut self, recorded: &Trajectory) -> Result<Trajectory> {
        match self.act_once(recorded) {
            Err(error) if is_of_no_episode(&error) => self.act_once(recorded),
            acted => acted,
        }
    }

    /// An environment that has failed is not used again.
    fn act_once(&mut self, recorded: &Trajectory) -> Result<Trajectory> {
        let name = EpisodeName {
            source: Source::try_from(recorded.source)?,
            iteration: recorded.iteration,
            lane: recorded.lane,
            episode: recorded.episode,
            policy_version: recorded.policy_version,
            run_seed: recorded.run_seed,
        };
        let mut episode = self.factory.begin(name, self.episode.take())?;
        // What the policy thought of its actions is no business of the environment.
        let mut log_probs = floats(&recorded.log_probs);
        for action in recorded.actions().chunks_exact(self.spec.action.bytes()) {
            if let Some(trajectory) = episode.step(action, log_probs.next())? {
                self.episode = Some(episode);
                return Ok(trajectory);
            }
        }
        ensure!(!recorded.actions().is_empty(), "expected actions to act again, found none");
        bail!("expected to end after step {}, found it going on", recorded.steps)
    }
}
