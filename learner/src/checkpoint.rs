//! Checkpoints: learner and proximity service saved together, whole or not at all.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result};
use protocol::messages::Checkpoint;
use protocol::run::{LEARNER_FILE, POLICY_FILE, PROXIMITY_FILE};
use protocol::weights::{self, Weights};

use crate::desk::{Entry, Order};
use crate::trainer::Trainer;

impl Trainer {
    /// Writes the checkpoint of the present iteration, unless it is there already, and removes
    /// those beyond the ones kept. Returns the hash of the reward model's weights.
    pub(crate) fn save(&mut self) -> Result<String> {
        let iteration = self.state.iteration;
        let folder = self.folder.checkpoint_folder(iteration);
        let unfinished = folder.with_extension("unfinished");
        let written = self.write(&unfinished, &folder);
        let sha256 = written.with_context(|| format!("checkpoint {}", folder.display()))?;
        let relative = folder.strip_prefix(self.folder.path()).unwrap_or(&folder);
        let checkpoint = Checkpoint {
            iteration,
            path: relative.display().to_string(),
            policy_sha256: weights::sha256([&self.state.parameters[..]]),
            proximity_sha256: sha256.clone(),
        };
        self.desk.order(Order::Record(Entry::Checkpoint(checkpoint)))?;
        let mut folders = self.folder.checkpoint_folders();
        folders.truncate(folders.len().saturating_sub(self.config.checkpoint.keep));
        for (_, old) in folders {
            fs::remove_dir_all(&old).with_context(|| format!("removal of {}", old.display()))?;
        }
        Ok(sha256)
    }

    /// The log goes to the disk first: no checkpoint is ahead of its log.
    fn write(&mut self, unfinished: &Path, folder: &Path) -> Result<String> {
        self.desk.sync()?;
        if unfinished.exists() {
            fs::remove_dir_all(unfinished)?;
        }
        fs::create_dir_all(unfinished)?;
        let policy = Weights::new(self.state.iteration, &self.state.parameters);
        policy.save(&unfinished.join(POLICY_FILE))?;
        self.state.save(&unfinished.join(LEARNER_FILE))?;
        let path = fs::canonicalize(unfinished)?.join(PROXIMITY_FILE);
        let sha256 = self.scoring.save(&path.display().to_string())?;
        if folder.exists() {
            fs::remove_dir_all(folder)?;
        }
        fs::rename(unfinished, folder)?;
        fs::File::open(self.folder.checkpoints())?.sync_all()?;
        Ok(sha256)
    }
}
