//! Reads the updates of a run from its log.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use mcap_log::{Contents, Entry, FileReader, Record, log_files, read_contents};
use protocol::Error;
use protocol::messages::{PolicyUpdate, Progress, RewardUpdate};

use crate::config::RunConfig;
use crate::folder::RunFolder;

/// An update of the policy. A quantity that the run's method does not have is NaN; its log has 0.
#[derive(Clone, Debug)]
pub struct Update {
    /// What was recorded of it.
    pub policy: PolicyUpdate,
    /// The last update of the reward model since the previous update of the policy, if there was one.
    pub reward: Option<RewardUpdate>,
}

impl Update {
    /// Returns an update of a run from its records.
    pub fn new(config: &RunConfig, policy: PolicyUpdate, reward: Option<RewardUpdate>) -> Update {
        Measured::by(Some(config)).update(policy, reward)
    }
}

/// Returns the progress of a run with its quantities as in an [`Update`].
pub fn measured(config: &RunConfig, progress: Progress) -> Progress {
    let Progress { update: Some(policy), reward_update, .. } = progress else { return progress };
    let Update { policy, reward } = Update::new(config, policy, reward_update);
    Progress { update: Some(policy), reward_update: reward, ..progress }
}

/// What the method of a run measures.
#[derive(Clone, Copy, Debug)]
struct Measured {
    rewards: bool,
    proximity: bool,
    /// How far the policy moved, as PPO does.
    divergence: bool,
}

impl Measured {
    /// Returns what a run with this configuration measures; everything if that is not known.
    fn by(config: Option<&RunConfig>) -> Measured {
        Measured {
            rewards: config.is_none_or(|config| config.reward.model.rewards),
            proximity: config.is_none_or(|config| config.reward.model.imitates),
            divergence: config.is_none_or(|config| config.learner.is_rewarded()),
        }
    }

    fn update(self, mut policy: PolicyUpdate, mut reward: Option<RewardUpdate>) -> Update {
        let keep = |quantity: &mut f64, is_measured: bool| {
            if !is_measured {
                *quantity = f64::NAN;
            }
        };
        let acts = policy.episodes > 0;
        keep(&mut policy.mean_episode_steps, acts);
        keep(&mut policy.mean_reward, acts && self.rewards);
        keep(&mut policy.mean_proximity, acts && self.proximity);
        keep(&mut policy.mean_uncertainty, acts && self.proximity);
        keep(&mut policy.approximate_kl, self.divergence);
        keep(&mut policy.clip_fraction, self.divergence);
        // A learner that has no such loss records exactly 0.
        let PolicyUpdate { policy_loss, value_loss, held_out_loss, .. } = &mut policy;
        for loss in [policy_loss, value_loss, held_out_loss] {
            let is_measured = *loss != 0.0;
            keep(loss, is_measured);
        }
        if let Some(reward) = &mut reward {
            keep(&mut reward.demonstration_loss, reward.gradient_steps > 0);
            keep(&mut reward.agent_loss, reward.gradient_steps > 0);
        }
        Update { policy, reward }
    }
}

/// Returns the updates among the entries of a run's log, in order.
pub fn updates<E: Iterator<Item = Result<Entry, Error>>>(
    folder: &RunFolder,
    entries: E,
) -> impl Iterator<Item = Result<Update, Error>> + use<E> {
    let measured = Measured::by(folder.config().ok().as_ref());
    let mut reward = None;
    entries.filter_map(move |entry| match entry.map(|entry| entry.record) {
        Ok(Record::PolicyUpdate(policy)) => Some(Ok(measured.update(*policy, reward.take()))),
        Ok(Record::RewardUpdate(update)) => {
            reward = Some(update);
            None
        }
        Ok(_) => None,
        Err(error) => Some(Err(error)),
    })
}

/// Returns the policy's updates in the log so far, in order, as in an [`Update`]; items fail as those of the log do.
///
/// # Errors
/// If the log does not exist or cannot be read.
pub fn policy_updates(
    folder: &RunFolder,
) -> Result<impl Iterator<Item = Result<PolicyUpdate, Error>>, Error> {
    let entries = read_contents(&folder.log(), Contents::Updates)?;
    Ok(updates(folder, entries).map(|update| update.map(|update| update.policy)))
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
    use crate::tasks::configuration;

    #[test]
    fn quantities_that_a_method_does_not_have_are_missing() {
        let update = |method, policy| {
            let method = [format!("method={method}")];
            let config = configuration("navigation", None, &method).unwrap();
            Update::new(&config, policy, Some(RewardUpdate::default()))
        };
        let cloning = |held_out_loss| {
            let policy = PolicyUpdate { held_out_loss, ..PolicyUpdate::default() };
            update("bc", policy).policy
        };
        assert_eq!(cloning(0.25).held_out_loss, 0.25);
        let cloned = cloning(0.0);
        let lacks = [cloned.held_out_loss, cloned.value_loss, cloned.mean_reward];
        assert!(lacks.iter().all(|number| number.is_nan()), "{cloned:?}");
        assert!(cloned.mean_episode_steps.is_nan() && cloned.approximate_kl.is_nan());

        let acting = || PolicyUpdate { episodes: 8, ..PolicyUpdate::default() };
        let expert = update("environment-reward", acting()).policy;
        assert_eq!([expert.mean_reward, expert.clip_fraction], [0.0, 0.0]);
        assert!(expert.mean_proximity.is_nan() && expert.mean_uncertainty.is_nan());
        let Update { policy, reward } = update("goal-proximity", acting());
        assert_eq!([policy.mean_reward, policy.mean_proximity], [0.0, 0.0]);
        assert!(reward.unwrap().agent_loss.is_nan(), "there were no gradient steps");
    }

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
