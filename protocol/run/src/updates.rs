//! The policy updates of a run, from its log.

use mcap_log::{Contents, Record, read_contents};
use protocol::Error;
use protocol::messages::PolicyUpdate;

use crate::folder::RunFolder;

/// What the log has so far, in order; an item fails as those of the log do.
///
/// # Errors
/// When the log is not there or cannot be read.
pub fn policy_updates(
    folder: &RunFolder,
) -> Result<impl Iterator<Item = Result<PolicyUpdate, Error>>, Error> {
    let entries = read_contents(&folder.log(), Contents::Updates)?;
    Ok(entries.filter_map(|entry| {
        entry
            .map(|entry| match entry.record {
                Record::PolicyUpdate(update) => Some(*update),
                _ => None,
            })
            .transpose()
    }))
}
