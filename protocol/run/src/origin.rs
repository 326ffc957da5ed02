//! What a run began with, according to its log, and whether that is still the same.

use mcap_log::{FileReader, recorded_metadata};
use protocol::build::{Build, short};
use protocol::trajectory::Trajectory;
use protocol::{Error, digest};
use serde::{Deserialize, Serialize};
use std::fmt;

use crate::config::RunConfig;
use crate::demonstrations::{DEMONSTRATIONS_SHA256, file_of, of_file};
use crate::folder::RunFolder;

/// Metadata key of demonstrations that says who acted.
pub const RECORDED_BY: &str = "expert";

/// Value of [`RECORDED_BY`] for the expert that comes with the task.
pub const TASKS_OWN: &str = "of the task";

/// Returns the SHA-256 of the demonstrations file that a run learns from; `None` if it does not imitate.
///
/// # Errors
/// [`Error::Demonstrations`] if the file cannot be read, or is not the one that the run began with.
pub fn demonstrations_sha256(
    folder: &RunFolder,
    config: &RunConfig,
) -> Result<Option<String>, Error> {
    if !config.imitates() {
        return Ok(None);
    }
    let path = file_of(folder, config);
    let failed = |message: String| Error::Demonstrations { path: path.clone(), message };
    let found = digest::sha256_of_file(&path).map_err(|cause| failed(cause.to_string()))?;
    let metadata = recorded_metadata(&folder.log()).unwrap_or_default();
    let mut recorded = metadata.iter().filter_map(|file| file.get(DEMONSTRATIONS_SHA256));
    match recorded.find(|expected| *expected != found) {
        None => Ok(Some(found)),
        Some(expected) => Err(failed(format!(
            "expected SHA-256 {expected}, which the run began with, found {found}: start a new run \
             to use other demonstrations"
        ))),
    }
}

/// Loads the demonstrations that a run learns from, after checking that they are those it began with.
///
/// # Errors
/// As [`demonstrations_sha256`] and [`of_file`].
pub fn load_demonstrations(
    folder: &RunFolder,
    config: &RunConfig,
) -> Result<Vec<Trajectory>, Error> {
    // Rebuilding a model of the run from other demonstrations would give another model.
    demonstrations_sha256(folder, config)?;
    of_file(&file_of(folder, config), config)
}

/// The demonstrations that a run learned from.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Demonstrations {
    /// SHA-256 of their file.
    pub sha256: String,
    /// Whether the task's own expert recorded them for the run's seed. Such demonstrations differ
    /// between seeds, like everything else that depends on the seed.
    pub of_own_seed: bool,
    /// The build that recorded them.
    pub build: Build,
}

impl Demonstrations {
    /// Returns the demonstrations of a run; `None` if it does not imitate.
    ///
    /// # Errors
    /// If their file cannot be read.
    pub fn of_run(folder: &RunFolder, config: &RunConfig) -> Result<Option<Demonstrations>, Error> {
        if !config.imitates() {
            return Ok(None);
        }
        let path = file_of(folder, config);
        let failed = |cause: std::io::Error| {
            let message = cause.to_string();
            Error::Demonstrations { path: path.clone(), message }
        };
        // If the log has the hash, the file need not be read as a whole.
        let log = recorded_metadata(&folder.log()).unwrap_or_default();
        let sha256 = match log.iter().find_map(|file| file.get(DEMONSTRATIONS_SHA256)) {
            Some(recorded) => recorded.to_owned(),
            None => digest::sha256_of_file(&path).map_err(failed)?,
        };
        let reader = FileReader::open(&path)?;
        let metadata = reader.metadata();
        let is_of_seed = metadata.get("seed") == Some(config.seed.to_string().as_str());
        let is_of_expert = metadata.get(RECORDED_BY) == Some(TASKS_OWN);
        Ok(Some(Demonstrations {
            sha256,
            of_own_seed: is_of_seed && is_of_expert,
            build: metadata.build(),
        }))
    }

    /// Returns marks that identify the demonstrations. Two runs that differ only in their seeds
    /// imitated the same expert data if they have a mark in common.
    pub fn marks(&self) -> Vec<String> {
        let of_own_seed = self.of_own_seed.then(|| format!("of its own seed, by {:?}", self.build));
        std::iter::once(self.sha256.clone()).chain(of_own_seed).collect()
    }
}

/// Writes one phrase.
impl fmt::Display for Demonstrations {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.of_own_seed {
            true => write!(formatter, "demonstrations by {}", self.build),
            false => write!(formatter, "demonstrations {}", short(&self.sha256)),
        }
    }
}

/// Returns the configurations that the files of a run's log were recorded under, by contents and number.
/// Those that cannot be read are left out.
///
/// # Errors
/// [`Error::LogRead`] if the folder cannot be listed.
pub fn recorded_configs(folder: &RunFolder) -> Result<Vec<RunConfig>, Error> {
    let metadata = recorded_metadata(&folder.log())?;
    Ok(metadata.iter().filter_map(|metadata| RunConfig::recorded(metadata)?.ok()).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use mcap_log::{Kind, LogOptions, LogWriter, Metadata};

    #[test]
    fn demonstrations_that_were_swapped_are_noticed() {
        let home = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(home.path());
        let config = crate::tasks::configuration("navigation", None, &[]).unwrap();
        let missing = demonstrations_sha256(&folder, &config).unwrap_err().to_string();
        assert!(missing.contains("demonstrations.mcap"), "{missing}");
        std::fs::write(folder.demonstrations_file(), "some").unwrap();
        let hash = demonstrations_sha256(&folder, &config).unwrap().unwrap();
        let metadata = Metadata::new(Kind::Run, "navigation", 1).with(DEMONSTRATIONS_SHA256, &hash);
        let mut log = LogWriter::create(&folder.log(), &metadata, LogOptions::default()).unwrap();
        log.finish().unwrap();
        assert_eq!(demonstrations_sha256(&folder, &config).unwrap(), Some(hash));
        std::fs::write(folder.demonstrations_file(), "other").unwrap();
        let message = demonstrations_sha256(&folder, &config).unwrap_err().to_string();
        assert!(message.contains("which the run began with"), "{message}");
        let message = load_demonstrations(&folder, &config).unwrap_err().to_string();
        assert!(message.contains("which the run began with"), "{message}");
    }
}
