//! Checkpoints: learner and proximity service saved together, whole or not at all.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use protocol::messages::{Checkpoint, Phase, RewardUpdate, Saved};
use protocol::tensors::Tensors;
use protocol::{Error, durable};
use run::folder::{LEARNER_FILE, POLICY_FILE, PROXIMITY_FILE};
use run::process::Final;

use crate::desk::{DISK_PATIENCE, Entry, Order};
use crate::service_client::Refused;
use crate::trainer::Trainer;

impl Trainer {
    /// Writes the checkpoint of the current iteration, unless it exists already, and removes the oldest ones
    /// beyond the number that is kept. Waits while the disk refuses, until the run is to stop.
    pub(crate) fn save(&mut self) -> Result<()> {
        let folder = self.folder.checkpoint_folder(self.state.iteration);
        if folder.exists() {
            return Ok(());
        }
        let unfinished = durable::unfinished(&folder);
        self.place.check()?;
        let mut is_paused = false;
        while let Err(error) = self.write(&unfinished, &folder) {
            self.place.check()?;
            let error = error.context(format!("checkpoint {}", folder.display()));
            if self.stop.is_requested() || !is_of_the_disk(&error) {
                return Err(error);
            }
            tracing::error!("paused until the checkpoint can be written: {error:#}");
            is_paused = true;
            self.tell(Phase::DiskFull, None, None)?;
            self.stop.sleep(DISK_PATIENCE);
        }
        if is_paused {
            self.tell(Phase::Training, None, None)?;
        }
        self.forget_offline_training()?;
        let mut folders = self.folder.checkpoint_folders();
        folders.truncate(folders.len().saturating_sub(self.config.checkpoint.keep));
        for (_, old) in folders {
            durable::remove_folder(&old)
                .with_context(|| format!("removal of {}", old.display()))?;
        }
        Ok(())
    }

    /// Removes what the service keeps of offline training, which is not needed once there is a checkpoint.
    fn forget_offline_training(&self) -> Result<()> {
        let file = self.folder.offline_file();
        match fs::remove_file(&file) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                Err(error).with_context(|| format!("removal of {}", file.display()))
            }
            _ => Ok(()),
        }
    }

    /// Writes a checkpoint. The log, with the checkpoint's own record, is on the disk before the checkpoint appears.
    fn write(&mut self, unfinished: &Path, folder: &Path) -> Result<()> {
        if unfinished.exists() {
            fs::remove_dir_all(unfinished)?;
        }
        durable::create_folder(unfinished)?;
        let policy = self.state.policy.weights(self.state.iteration);
        let policy_file_sha256 = policy.save(&unfinished.join(POLICY_FILE))?;
        let mut tensors = Tensors::default();
        self.state.save(&mut tensors);
        self.learner.save(&mut tensors);
        tensors
            .expect_finite()
            .map_err(|message| Final(format!("the learner diverged: {message}")))?;
        let learner_file_sha256 = tensors.save(&unfinished.join(LEARNER_FILE))?;
        let path = fs::canonicalize(unfinished)?.join(PROXIMITY_FILE);
        let proximity = self.service.save(&path.display().to_string())?;
        expect_newest(&proximity, self.progress.reward_update.as_ref())?;
        let relative = folder.strip_prefix(self.folder.path()).unwrap_or(folder);
        let checkpoint = Checkpoint {
            iteration: self.state.iteration,
            path: relative.display().to_string(),
            policy_sha256: policy.sha256(),
            proximity_sha256: proximity.weights_sha256,
            policy_file_sha256,
            learner_file_sha256,
            proximity_file_sha256: proximity.file_sha256,
        };
        self.desk.order(Order::Record(Entry::Checkpoint(checkpoint)))?;
        self.desk.sync()?;
        Ok(durable::rename(unfinished, folder)?)
    }
}

/// Refuses a reward model that is not that of the newest update, for example because the service was restarted.
fn expect_newest(saved: &Saved, newest: Option<&RewardUpdate>) -> Result<()> {
    let expected = newest.map_or("none", |update| update.weights_sha256.as_str());
    let found = saved.weights_sha256.as_str();
    ensure!(
        expected == found,
        "expected the proximity service to save the reward model {expected}, found {found}"
    );
    Ok(())
}

/// Returns whether a file could not be written, by the learner or by the proximity service.
fn is_of_the_disk(error: &anyhow::Error) -> bool {
    error.chain().any(|cause| {
        let ours = matches!(cause.downcast_ref(), Some(Error::Checkpoint { .. }));
        ours || cause.is::<std::io::Error>() || cause.is::<Refused>()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_reward_model_than_the_newest_ends_the_learner_which_does_not_wait() {
        let update = |hash: &str| {
            let weights_sha256 = hash.to_owned();
            RewardUpdate { weights_sha256, ..RewardUpdate::default() }
        };
        let saved = Saved { weights_sha256: "aa".to_owned(), ..Saved::default() };
        expect_newest(&saved, Some(&update("aa"))).unwrap();
        for newest in [Some(update("bb")), None] {
            let error = expect_newest(&saved, newest.as_ref()).unwrap_err();
            assert!(error.to_string().ends_with("found aa") && !is_of_the_disk(&error), "{error}");
        }
    }
}
