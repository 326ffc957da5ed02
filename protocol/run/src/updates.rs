//! The updates of a run, from its log.

use mcap_log::{Contents, Entry, Record, read_contents};
use protocol::Error;
use protocol::messages::{PolicyUpdate, RewardUpdate};

use crate::folder::RunFolder;

/// An update of the policy.
#[derive(Clone, Debug)]
pub struct Update {
    /// The record of it.
    pub policy: PolicyUpdate,
    /// The last update of the reward model before it, unless that came before an earlier one.
    pub reward: Option<RewardUpdate>,
}

/// What the entries of a log have of updates, in order.
pub fn updates(
    entries: impl Iterator<Item = Result<Entry, Error>>,
) -> impl Iterator<Item = Result<Update, Error>> {
    let mut reward = None;
    entries.filter_map(move |entry| match entry.map(|entry| entry.record) {
        Ok(Record::PolicyUpdate(policy)) => {
            Some(Ok(Update { policy: *policy, reward: reward.take() }))
        }
        Ok(Record::RewardUpdate(update)) => {
            reward = Some(update);
            None
        }
        Ok(_) => None,
        Err(error) => Some(Err(error)),
    })
}

/// The policy's updates that the log has so far, in order; an item fails as those of the log do.
///
/// # Errors
/// When the log is not there or cannot be read.
pub fn policy_updates(
    folder: &RunFolder,
) -> Result<impl Iterator<Item = Result<PolicyUpdate, Error>>, Error> {
    let entries = read_contents(&folder.log(), Contents::Updates)?;
    Ok(updates(entries).map(|update| update.map(|update| update.policy)))
}
