//! Reassembles the batches that a run learned from while its log is read.

use std::collections::HashMap;

use bytes::Bytes;
use protocol::Error;
use protocol::messages::PolicyUpdate;
use protocol::task::Spec;
use protocol::trajectory::{Encoded, TrajectoryKey};

/// The trajectories of a log that no update read so far has learned from.
pub struct Batches {
    spec: Spec,
    trajectories: HashMap<TrajectoryKey, Encoded>,
}

impl Batches {
    /// Starts before the first record of a log.
    pub fn new(spec: Spec) -> Batches {
        Batches { spec, trajectories: HashMap::new() }
    }

    /// Adds a recorded trajectory.
    ///
    /// # Errors
    /// If it does not fit the task, or has no observations.
    pub fn add(&mut self, bytes: Bytes) -> Result<(), Error> {
        let encoded = Encoded::decode(bytes, &self.spec)?;
        self.trajectories.insert(encoded.key, encoded);
        Ok(())
    }

    /// Returns the batch of an update, in the order it was learned from. In a log, the update comes after its batch.
    ///
    /// # Errors
    /// [`Error::Batch`] if one of its trajectories has not been added.
    pub fn take(&mut self, update: &PolicyUpdate) -> Result<Vec<Encoded>, Error> {
        let iteration = update.iteration;
        let taken = |key: &TrajectoryKey| {
            let TrajectoryKey { lane, episode, .. } = *key;
            let found = self.trajectories.remove(key);
            found.ok_or(Error::Batch { iteration, lane, episode })
        };
        update.consumed.iter().map(taken).collect()
    }
}
