//! Checks that runs learned from what is in the files of demonstrations that their plans name.

use std::collections::BTreeMap;

use anyhow::{Context, Result};
use protocol::digest;
use run::folder::RunFolder;
use run::origin::Demonstrations;
use run::summary::Summary;

use super::archive::Archive;
use super::planned_run::PlannedRun;
use terminal::refusal::wrong_usage;

/// Refuses runs that learned from other demonstrations than are in the file that their plan names.
///
/// # Errors
/// Wrong usage, in a line that names one of these runs; also when a file cannot be read.
pub(crate) fn refuse_other_demonstrations(
    runs: &[PlannedRun],
    archive: &mut Archive,
) -> Result<()> {
    let mut hashes = BTreeMap::new();
    for run in runs {
        let Some(file) = &run.config.demonstrations.file else { continue };
        let Some(learned_from) = learned_from(&archive.folder_of(run)) else { continue };
        if !hashes.contains_key(file) {
            let hash = digest::sha256_of_file(file).with_context(|| file.display().to_string())?;
            hashes.insert(file, hash);
        }
        if hashes[file] != learned_from {
            let (name, runs) = (archive.name_of(run), archive.runs());
            return Err(wrong_usage(format!(
                "{}: expected the demonstrations of {name}, SHA-256 {learned_from}, found {}; another --out trains \
                 all runs again, or remove {}",
                file.display(),
                hashes[file],
                runs.join(&name).display()
            )));
        }
    }
    Ok(())
}

/// Returns the SHA-256 of the demonstrations that a run learned from; `None` if it has not begun, or does not imitate.
fn learned_from(folder: &RunFolder) -> Option<String> {
    let known = match Summary::of_run(folder) {
        Ok(Some(summary)) => summary.demonstrations,
        _ => Demonstrations::of_run(folder, &folder.config().ok()?).ok()?,
    };
    known.map(|demonstrations| demonstrations.sha256)
}
