//! What a run's log has lost of all that was recorded.

use std::path::PathBuf;

use mcap_log::Ending;

use crate::folder::RunFolder;
use crate::summary::Summary;

/// A line for each file of which something could not be read. One that is being written has lost nothing.
pub fn of_files(endings: &[(PathBuf, Ending)]) -> impl Iterator<Item = String> {
    let lost = endings.iter().filter(|(_, ending)| ending.lost());
    lost.map(|(path, ending)| format!("{}: {ending}", path.display()))
}

/// What a finished run's log lacks of the episodes that its summary counts, if `found` are not as many:
/// whole files may be gone.
pub fn of_episodes(folder: &RunFolder, found: u64) -> Option<String> {
    let expected = Summary::of_run(folder).ok()??.log.trajectories;
    let log = folder.log();
    (found < expected).then(|| {
        format!(
            "{}: expected {expected} episodes, as summary.json has them, found {found}",
            log.display()
        )
    })
}
