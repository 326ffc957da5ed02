//! Reads the updates of a run from its log.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use mcap_log::{Contents, Entry, FileReader, Record, log_files, read_contents};
use protocol::Error;
use protocol::messages::{PolicyUpdate, RewardUpdate};

use crate::folder::RunFolder;

/// An update of the policy.
#[derive(Clone, Debug)]
pub struct Update {
    /// Its record in the log.
    pub policy: PolicyUpdate,
    /// The last update of the reward model since the previous update of the policy, if there was one.
    pub reward: Option<RewardUpdate>,
}

/// Returns the updates among the entries of a log, in order.
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

/// Returns the policy's updates in the log so far, in order; items fail as those of the log do.
///
/// # Errors
/// If the log does not exist or cannot be read.
pub fn policy_updates(
    folder: &RunFolder,
) -> Result<impl Iterator<Item = Result<PolicyUpdate, Error>>, Error> {
    let entries = read_contents(&folder.log(), Contents::Updates)?;
    Ok(updates(entries).map(|update| update.map(|update| update.policy)))
}

/// Returns when a run began: when its configuration was written, which happens again at every resumption, or the
/// time of the first record in its log, less the duration of the offline training it reports; whichever is earlier.
pub fn begun(folder: &RunFolder) -> Option<SystemTime> {
    let laid_out = folder.config_file().metadata().and_then(|file| file.modified()).ok();
    let recorded = first_entry(folder).and_then(|entry| before(&entry));
    laid_out.into_iter().chain(recorded).min()
}

fn first_entry(folder: &RunFolder) -> Option<Entry> {
    let files = log_files(&folder.log()).ok()?.into_iter();
    let mut files = files.filter(|file| file.contents == Contents::Updates);
    files.find_map(|file| FileReader::open(&file.path).ok()?.next()?.ok())
}

fn before(first: &Entry) -> Option<SystemTime> {
    let seconds = match &first.record {
        Record::RewardUpdate(offline) => offline.seconds,
        _ => 0.0,
    };
    let recorded = UNIX_EPOCH + Duration::from_nanos(first.log_time_ns);
    recorded.checked_sub(Duration::try_from_secs_f64(seconds).unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use std::fs::{self, File};

    use mcap_log::{Kind, LogOptions, LogWriter, Metadata};

    use super::*;

    fn lay_out(folder: &RunFolder, time: SystemTime) {
        fs::write(folder.config_file(), "").unwrap();
        let file = File::options().write(true).open(folder.config_file()).unwrap();
        file.set_modified(time).unwrap();
    }

    fn sit(folder: &RunFolder, seconds: f64) {
        let metadata = Metadata::new(Kind::Run, "navigation", 1);
        let options = LogOptions::default();
        let mut log = LogWriter::create(&folder.log(), &metadata, options).unwrap();
        log.reward_update(&RewardUpdate { seconds, ..RewardUpdate::default() }).unwrap();
        log.finish().unwrap();
    }

    #[test]
    fn resuming_does_not_change_when_a_run_was_begun() {
        let directory = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(directory.path());
        assert_eq!(begun(&folder), None);
        let laid_out = UNIX_EPOCH + Duration::from_secs(1_700_000_000);
        lay_out(&folder, laid_out);
        assert_eq!(begun(&folder), Some(laid_out));
        let before = SystemTime::now();
        sit(&folder, 9.0);
        let after = SystemTime::now();
        assert_eq!(begun(&folder), Some(laid_out), "not when there was something to record");

        let tomorrow = after + Duration::from_secs(86_400);
        lay_out(&folder, tomorrow);
        let found = begun(&folder).unwrap();
        let recorded = found + Duration::from_secs(9);
        assert!((before..=after).contains(&recorded), "{recorded:?}");
        sit(&folder, 1.0);
        lay_out(&folder, tomorrow + Duration::from_secs(86_400));
        assert_eq!(begun(&folder), Some(found));
    }
}
