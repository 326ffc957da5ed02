//! The batches that a run has learned from, put together again while its log is read.

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
    /// Before the first record of a log.
    pub fn new(spec: Spec) -> Batches {
        Batches { spec, trajectories: HashMap::new() }
    }

    /// Takes in a trajectory's record.
    ///
    /// # Errors
    /// If it is none of the task, or has no observations.
    pub fn add(&mut self, bytes: Bytes) -> Result<(), Error> {
        let encoded = Encoded::decode(bytes, &self.spec)?;
        self.trajectories.insert(encoded.key, encoded);
        Ok(())
    }

    /// The batch of an update, in the order it was learned from. The update comes behind it in a log.
    ///
    /// # Errors
    /// [`Error::Batch`] if a trajectory of it has not come.
    pub fn take(&mut self, update: &PolicyUpdate) -> Result<Vec<Encoded>, Error> {
        let taken = |key: &TrajectoryKey| self.trajectories.remove(key);
        let batch: Option<Vec<Encoded>> = update.consumed.iter().map(taken).collect();
        batch.ok_or(Error::Batch { iteration: update.iteration })
    }
}
