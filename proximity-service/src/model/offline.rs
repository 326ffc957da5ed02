//! Offline training in slices, so that whoever trains can look at requests in between, and go on from a
//! file another day.

use protocol::messages::{Pretraining, RewardUpdate};
use protocol::tensors::Tensors;

use super::minibatch::{Losses, MinibatchRows};

/// Where offline training stands after a slice of it.
#[derive(Clone, Debug, PartialEq)]
pub enum Slice {
    /// There is more to do.
    UnderWay(Pretraining),
    /// It is done.
    Done(RewardUpdate),
}

/// How far offline training has come.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Progress {
    /// Gradient steps taken.
    pub(super) done: usize,
    /// Losses of those, summed in order.
    pub(super) sum: Losses,
    /// Time they took.
    pub(super) seconds: f64,
}

/// Offline training under way.
pub(super) struct Offline {
    /// All minibatches, in order.
    pub(super) minibatches: Vec<MinibatchRows>,
    pub(super) progress: Progress,
}

impl Offline {
    /// The next minibatch, and its number from 1.
    pub(super) fn next(&self) -> Option<(usize, &MinibatchRows)> {
        let done = self.progress.done;
        Some((done + 1, self.minibatches.get(done)?))
    }

    /// How far it has come, in words of the bus.
    pub(super) fn standing(&self) -> Pretraining {
        let total = self.minibatches.len() as u64;
        Pretraining { done: self.progress.done as u64, total }
    }
}

impl Progress {
    /// Notes a step.
    pub(super) fn add(&mut self, losses: Losses) {
        self.done += 1;
        self.sum += losses;
    }

    /// The mean losses; zero before the first step.
    pub(super) fn mean(&self) -> Losses {
        self.sum.divided_by(self.done)
    }

    /// Adds it to arrays.
    pub(super) fn save(&self, tensors: &mut Tensors) {
        tensors.put_u64("offline.done", [self.done as u64]);
        let Losses { demonstrations, agent } = self.sum;
        tensors.put_f64("offline.sums", [demonstrations, agent, self.seconds]);
    }

    /// What [`Progress::save`] added; that of the beginning where nothing was.
    pub(super) fn restored(tensors: &Tensors) -> Result<Progress, String> {
        if !tensors.has("offline.done") {
            return Ok(Progress::default());
        }
        let done = tensors.exactly("offline.done", 1, Tensors::u64)?[0] as usize;
        let sums = tensors.exactly("offline.sums", 3, Tensors::f64)?;
        let sum = Losses { demonstrations: sums[0], agent: sums[1] };
        Ok(Progress { done, sum, seconds: sums[2] })
    }
}
