//! A lease in progress: one lane's episodes, one after another, until what is owed has been run.

use anyhow::Result;
use protocol::messages::Lease;
use protocol::trajectory::{Source, Trajectory};

use crate::episode::{Episode, EpisodeName};
use crate::factory::Factory;

/// A lease in progress.
pub struct Lane {
    /// The lease that was granted.
    pub lease: Lease,
    steps_owed: u64,
    episodes_owed: u64,
    name: EpisodeName,
    /// The episode in progress.
    pub episode: Episode,
}

impl Lane {
    /// Begins the first episode of a lease, in the environment of an earlier episode if there is one.
    ///
    /// # Errors
    /// When the lease has an unknown source, or the environment fails.
    pub fn begin(
        lease: Lease,
        factory: &Factory,
        earlier: Option<Episode>,
        run_seed: u64,
    ) -> Result<Lane> {
        let name = EpisodeName {
            source: Source::try_from(lease.source)?,
            iteration: lease.iteration,
            lane: lease.lane,
            episode: lease.first_episode,
            policy_version: lease.policy_version,
            run_seed,
        };
        let episode = factory.begin(name, earlier)?;
        let Lease { steps_owed, episodes_owed, .. } = lease;
        Ok(Lane { lease, steps_owed, episodes_owed, name, episode })
    }

    /// Takes one step. Returns the trajectory if an episode has ended; the next episode has then begun, if one is owed.
    ///
    /// # Errors
    /// When the environment fails.
    pub fn step(&mut self, action: &[u8], log_prob: Option<f32>) -> Result<Option<Trajectory>> {
        let Some(trajectory) = self.episode.step(action, log_prob)? else { return Ok(None) };
        self.steps_owed = self.steps_owed.saturating_sub(u64::from(trajectory.steps));
        self.episodes_owed = self.episodes_owed.saturating_sub(1);
        if !self.is_done() {
            self.name.episode += 1;
            self.episode.begin_again(self.name)?;
        }
        Ok(Some(trajectory))
    }

    /// Returns what the lane's episodes are for.
    pub fn source(&self) -> Source {
        self.name.source
    }

    /// Returns whether everything that is owed has been run.
    pub fn is_done(&self) -> bool {
        self.steps_owed == 0 && self.episodes_owed == 0
    }
}
