//! What a run's log says the run began with, and whether it is still there.

use crate::config::RunConfig;
use crate::demonstrations::file_of;
use crate::log::recorded_metadata;
use crate::run::RunFolder;
use crate::{Error, digest};

/// What the metadata of a run's log calls the hash of its demonstrations.
pub const DEMONSTRATIONS_SHA256: &str = "demonstrations_sha256";

/// SHA-256 of the file of demonstrations that a run learns from; none where it imitates nobody.
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
            "expected SHA-256 {expected}, which the run began with, found {found}: other \
             demonstrations make another run"
        ))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::log::{Kind, LogOptions, LogWriter, Metadata};

    #[test]
    fn demonstrations_that_were_swapped_are_noticed() {
        let home = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(home.path());
        let task = include_str!("../../deploy/tasks/navigation.toml");
        let methods = include_str!("../../deploy/methods.toml");
        let config = RunConfig::assemble(task, methods, "goalward", &[]).unwrap();
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
    }
}
