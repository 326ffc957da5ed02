//! Assembles the batch of an iteration from trajectories that actors publish and that the learner sends again.
//! Bytes that do not match the key they came under count as missing.

use std::collections::BTreeMap;

use anyhow::{Result, bail, ensure};
use bytes::Bytes;
use protocol::messages::{BatchRequest, Missing};
use protocol::task::Spec;
use protocol::trajectory::{Encoded, TrajectoryKey};

/// Received trajectories, and the batch assembled from some of them.
pub(crate) struct Intake {
    spec: Spec,
    /// Encoded trajectories that were received and are not yet part of a batch.
    received: BTreeMap<TrajectoryKey, Bytes>,
    batch: Vec<Encoded>,
    iteration: Option<u64>,
}

impl Intake {
    /// Creates an empty intake for a task.
    pub(crate) fn new(spec: Spec) -> Intake {
        Intake { spec, received: BTreeMap::new(), batch: Vec::new(), iteration: None }
    }

    /// Keeps a trajectory until a batch asks for it; its bytes are checked then.
    pub(crate) fn receive(&mut self, key: TrajectoryKey, bytes: Bytes) {
        self.received.insert(key, bytes);
    }

    /// Returns the number of bytes of all trajectories that wait for a batch.
    pub(crate) fn received_bytes(&self) -> usize {
        self.received.values().map(Bytes::len).sum()
    }

    /// Drops the batch.
    pub(crate) fn begin_anew(&mut self) {
        self.batch.clear();
        self.iteration = None;
    }

    /// Assembles a batch and returns what is missing.
    ///
    /// # Errors
    /// When something supplied is not a trajectory of the task, or not part of the batch.
    pub(crate) fn take(&mut self, batch: BatchRequest) -> Result<Missing> {
        for bytes in batch.supplied {
            let Encoded { key, bytes, .. } = Encoded::decode(bytes, &self.spec)?;
            ensure!(
                batch.keys.contains(&key),
                "lane {} episode {}: expected a trajectory of the batch, found one of hash {:016x}",
                key.lane,
                key.episode,
                key.hash
            );
            self.received.insert(key, bytes);
        }
        if self.iteration == Some(batch.iteration) {
            return Ok(Missing::default());
        }
        let decode = |key: &TrajectoryKey| {
            let encoded = Encoded::decode(self.received.get(key)?.clone(), &self.spec).ok()?;
            (encoded.key == *key).then_some(encoded)
        };
        let decoded: Vec<Option<Encoded>> = batch.keys.iter().map(decode).collect();
        let missing = decoded.iter().enumerate().filter(|(_, encoded)| encoded.is_none());
        let positions: Vec<u32> = missing.map(|(at, _)| at as u32).collect();
        if !positions.is_empty() {
            return Ok(Missing { positions });
        }
        self.batch = decoded.into_iter().flatten().collect();
        self.iteration = Some(batch.iteration);
        self.forget_past();
        Ok(Missing::default())
    }

    /// Drops what was received up to each lane's last episode in the batch, copies of repeated episodes included.
    fn forget_past(&mut self) {
        let newest: BTreeMap<u64, u64> =
            self.batch.iter().map(|encoded| (encoded.key.lane, encoded.key.episode)).collect();
        let is_new = |key: &TrajectoryKey| {
            newest.get(&key.lane).is_none_or(|&episode| key.episode > episode)
        };
        self.received.retain(|key, _| is_new(key));
    }

    /// Returns the batch of an iteration.
    ///
    /// # Errors
    /// When the current batch is that of another iteration, or there is none.
    pub(crate) fn batch(&self, iteration: u64) -> Result<&[Encoded]> {
        match self.iteration {
            Some(found) if found == iteration => Ok(&self.batch),
            Some(present) => {
                bail!("expected a request about iteration {present}, found one about {iteration}")
            }
            None => {
                bail!("expected a batch before a request about iteration {iteration}, found none")
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::{CORRIDOR, walk};
    use protocol::trajectory::{Source, Trajectory};

    fn episode(number: u64) -> Encoded {
        Encoded::encode(Trajectory { episode: number, ..walk(0.0, Source::Training) })
    }

    fn named(iteration: u64, batch: &[&Encoded], supplied: &[&Encoded]) -> BatchRequest {
        BatchRequest {
            iteration,
            keys: batch.iter().map(|encoded| encoded.key).collect(),
            supplied: supplied.iter().map(|encoded| encoded.bytes.clone()).collect(),
        }
    }

    #[test]
    fn bytes_under_a_key_that_is_not_theirs_are_missing_and_supplied_again() {
        let (first, second) = (episode(0), episode(1));
        let mut intake = Intake::new(CORRIDOR);
        intake.receive(first.key, first.bytes.clone());
        let mut forged = second.bytes.to_vec();
        *forged.last_mut().unwrap() ^= 1;
        for bytes in [first.bytes.clone(), forged.into(), Bytes::from_static(b"nothing")] {
            intake.receive(second.key, bytes);
            let missing = intake.take(named(3, &[&first, &second], &[])).unwrap();
            assert_eq!(missing.positions, [1]);
            let message = intake.batch(3).unwrap_err().to_string();
            assert_eq!(message, "expected a batch before a request about iteration 3, found none");
        }
        let missing = intake.take(named(3, &[&first, &second], &[&second])).unwrap();
        assert_eq!(missing, Missing::default());
        assert_eq!(intake.batch(3).unwrap(), [first, second]);
        let message = intake.batch(2).unwrap_err().to_string();
        assert_eq!(message, "expected a request about iteration 3, found one about 2");
    }

    #[test]
    fn what_was_not_asked_for_is_refused() {
        let (first, second) = (episode(0), episode(1));
        let mut intake = Intake::new(CORRIDOR);
        let message = intake.take(named(0, &[&first], &[&second])).unwrap_err().to_string();
        assert!(message.contains("episode 1: expected a trajectory of the batch"), "{message}");
        assert!(intake.received.is_empty());
    }

    #[test]
    fn a_batch_leaves_only_what_comes_behind_it() {
        let mut intake = Intake::new(CORRIDOR);
        let episodes = [0, 1, 2].map(episode);
        for encoded in &episodes {
            intake.receive(encoded.key, encoded.bytes.clone());
        }
        intake.take(named(0, &[&episodes[0], &episodes[1]], &[])).unwrap();
        assert_eq!(intake.received.keys().collect::<Vec<_>>(), [&episodes[2].key]);
    }
}
