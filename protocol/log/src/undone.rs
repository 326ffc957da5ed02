//! The records that a run has undone: it went back to a checkpoint, and has not come as far again yet.
//!
//! Iterations after the checkpoint are recorded again. Until then, their old records would come before the iterations
//! that they follow.

use super::name::Name;
use super::topic::Topic;

/// A training trajectory or a policy update, which show how far a run is.
pub(super) struct Mark {
    log_time_ns: u64,
    iteration: u64,
    is_update: bool,
}

impl Mark {
    /// Returns the mark of a record; `None` if it is of another topic.
    pub(super) fn of(&(topic, iteration, ..): &Name, log_time_ns: u64) -> Option<Mark> {
        let is_update = topic == Topic::PolicyUpdate;
        let tells = is_update || topic == Topic::Trajectory;
        tells.then_some(Mark { log_time_ns, iteration, is_update })
    }
}

/// A run's return to a checkpoint: after this time, it did the iterations from this one on again.
pub(super) struct Return {
    log_time_ns: u64,
    iteration: u64,
}

impl Return {
    /// Finds all returns in the marks of all files.
    pub(super) fn all(mut marks: Vec<Mark>) -> Vec<Return> {
        marks.sort_by_key(|mark| mark.log_time_ns);
        let mut returns = Vec::new();
        let mut learned = None;
        for Mark { log_time_ns, iteration, is_update } in marks {
            if learned.is_some_and(|newest| iteration <= newest) {
                returns.push(Return { log_time_ns, iteration });
                learned = iteration.checked_sub(1);
            }
            if is_update {
                learned = Some(iteration);
            }
        }
        returns
    }

    /// Returns whether this return undoes a record of that log time. Checkpoints stay valid. Updates of the reward
    /// model in iteration 0 stay, because offline training is recorded again before the return shows.
    pub(super) fn undoes(&self, &(topic, iteration, ..): &Name, log_time_ns: u64) -> bool {
        let stays = match topic {
            Topic::Checkpoint => true,
            Topic::RewardUpdate => iteration == 0,
            _ => false,
        };
        !stays && iteration >= self.iteration && log_time_ns < self.log_time_ns
    }
}
