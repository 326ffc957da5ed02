//! Offline training in slices, so that requests can be served in between and training can resume from a file.

use protocol::messages::{Pretraining, RewardUpdate};
use protocol::tensors::Tensors;

use super::minibatch::{Losses, Positions};

/// Outcome of a slice of offline training.
#[derive(Clone, Debug, PartialEq)]
pub enum Slice {
    /// Training is not finished.
    UnderWay(Pretraining),
    /// Training is finished.
    Done(RewardUpdate),
}

/// Gradient steps taken so far, offline or in an online update.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Progress {
    /// Gradient steps taken.
    pub(super) done: usize,
    /// Losses of these steps, summed in order.
    pub(super) sum: Losses,
    /// Time these steps took.
    pub(super) seconds: f64,
}

/// Offline training that is under way.
pub(super) struct Offline {
    /// All minibatches, in order.
    pub(super) minibatches: Vec<Positions>,
    pub(super) progress: Progress,
}

impl Offline {
    /// Returns the next minibatch, and its number starting from 1.
    pub(super) fn next(&self) -> Option<(usize, &Positions)> {
        let done = self.progress.done;
        Some((done + 1, self.minibatches.get(done)?))
    }

    /// Returns the progress as a message for the bus.
    pub(super) fn standing(&self) -> Pretraining {
        let total = self.minibatches.len() as u64;
        Pretraining { done: self.progress.done as u64, total }
    }
}

impl Progress {
    /// Records a step.
    pub(super) fn add(&mut self, losses: Losses) {
        self.done += 1;
        self.sum += losses;
    }

    /// Returns the mean losses; zero before the first step.
    pub(super) fn mean(&self) -> Losses {
        self.sum.divided_by(self.done)
    }

    /// Adds the progress to `tensors`.
    pub(super) fn save(&self, tensors: &mut Tensors) {
        tensors.put_u64("offline.done", [self.done as u64]);
        let Losses { demonstrations, agent } = self.sum;
        tensors.put_f64("offline.sums", [demonstrations, agent, self.seconds]);
    }

    /// Restores what [`Progress::save`] added; the default if there is nothing.
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
