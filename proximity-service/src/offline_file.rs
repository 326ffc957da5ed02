//! The file from which offline training resumes after a stop or a crash. Only this service uses it, so it holds its
//! own hash and the hash of the model that training began with. A file that is damaged or has another beginning is
//! ignored.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use protocol::durable;
use protocol::tensors::Tensors;

/// Interval between saves: the most training that a crash can cost.
const SAVE_EVERY: Duration = Duration::from_secs(10);

/// Name of the array with the hash of all other arrays.
const HASH: &str = "sha256";

/// Name of the array with the hash of the model that training began with.
const BEGINNING: &str = "beginning";

/// Name prefix of the model's arrays.
const MODEL: &str = "model.";

/// Name of the array with the processor time spent on training, in seconds.
const SPENT: &str = "spent_s";

/// File that offline training is saved to while it is under way.
pub(crate) struct OfflineFile {
    path: PathBuf,
    beginning: String,
    spent_s: f64,
    saved: Instant,
}

impl OfflineFile {
    /// Creates the handle of the file at `path`, for training that begins with the model `fresh`.
    pub(crate) fn new(path: PathBuf, fresh: &Tensors) -> OfflineFile {
        OfflineFile { path, beginning: fresh.sha256(), spent_s: 0.0, saved: Instant::now() }
    }

    /// Loads the saved model, if there is a valid one, and resumes counting its processor time.
    pub(crate) fn load(&mut self) -> Option<Tensors> {
        self.spent_s = 0.0;
        if !self.path.exists() {
            return None;
        }
        match self.checked() {
            Ok((tensors, spent_s)) => {
                self.spent_s = spent_s;
                Some(tensors)
            }
            Err(error) => {
                tracing::warn!("offline training starts over: {error:#}");
                None
            }
        }
    }

    fn checked(&self) -> Result<(Tensors, f64)> {
        let mut tensors = Tensors::load(&self.path)?;
        let hash = tensors.take_text(HASH).map_err(anyhow::Error::msg)?;
        anyhow::ensure!(
            hash == tensors.sha256(),
            "{}: expected SHA-256 {hash}, found {}",
            self.path.display(),
            tensors.sha256()
        );
        let beginning = tensors.take_text(BEGINNING).map_err(anyhow::Error::msg)?;
        anyhow::ensure!(
            beginning == self.beginning,
            "{}: expected training from {}, found from {beginning}",
            self.path.display(),
            self.beginning
        );
        let spent = tensors.exactly(SPENT, 1, Tensors::f64).map_err(anyhow::Error::msg)?;
        Ok((tensors.all(MODEL), spent[0]))
    }

    /// Adds to the processor time of training. Returns the total, including that of earlier processes.
    pub(crate) fn spend(&mut self, processor_s: f64) -> f64 {
        self.spent_s += processor_s;
        self.spent_s
    }

    /// Returns whether the model is due to be saved again.
    pub(crate) fn is_due(&self) -> bool {
        self.saved.elapsed() >= SAVE_EVERY
    }

    /// Saves the model. A failure is only logged: it costs time after a crash, nothing else.
    pub(crate) fn save(&mut self, model: Tensors) {
        self.saved = Instant::now();
        if let Err(error) = self.write(model) {
            tracing::warn!("offline training cannot be kept: {error:#}");
        }
    }

    fn write(&self, model: Tensors) -> Result<()> {
        let mut kept = Tensors::default();
        kept.put_all(MODEL, model);
        kept.put_u8(BEGINNING, self.beginning.bytes());
        kept.put_f64(SPENT, [self.spent_s]);
        let hash = kept.sha256();
        kept.put_u8(HASH, hash.bytes());
        if let Some(folder) = self.path.parent() {
            durable::create_folder(folder).with_context(|| folder.display().to_string())?;
        }
        kept.save(&self.path)?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn what_was_kept_is_there_unless_it_is_damaged_or_of_another_beginning() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("checkpoints/offline.safetensors");
        let [mut fresh, mut trained] = [(); 2].map(|()| Tensors::default());
        fresh.put_f32("weights", [1.0]);
        trained.put_f32("weights", [2.0]);
        let mut file = OfflineFile::new(path.clone(), &fresh);
        assert_eq!(file.load(), None);
        file.spend(2.0);
        file.save(trained.clone());
        let mut file = OfflineFile::new(path.clone(), &fresh);
        assert_eq!(file.load(), Some(trained.clone()));
        assert_eq!(file.spend(1.0), 3.0, "the processor time of both");
        assert_eq!(OfflineFile::new(path.clone(), &trained).load(), None);
        let mut bytes = fs::read(&path).unwrap();
        for at in [3, bytes.len() - 3, bytes.len() / 2] {
            bytes[at] ^= 1;
            fs::write(&path, &bytes).unwrap();
            assert_eq!(file.load(), None, "byte {at}");
            bytes[at] ^= 1;
        }
        fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
        assert_eq!(file.load(), None);
    }
}
