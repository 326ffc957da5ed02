//! What a run's log has lost of all that was recorded.

use mcap_log::RunReader;

use crate::folder::RunFolder;
use crate::summary::Summary;

/// A line for each file of which something could not be read, and one if the log lacks some of a finished
/// run's episodes. A file that is being written has lost nothing.
pub fn of_log(folder: &RunFolder, log: &RunReader) -> Vec<String> {
    let lost = log.endings().iter().filter(|(_, ending)| ending.lost());
    let files = lost.map(|(path, ending)| format!("{}: {ending}", path.display()));
    files.chain(of_episodes(folder, log.trajectories())).collect()
}

/// What a finished run's log lacks of the episodes that its summary counts, if `found` are not as many:
/// whole files may be gone.
fn of_episodes(folder: &RunFolder, found: u64) -> Option<String> {
    let expected = Summary::of_run(folder).ok()??.log.trajectories;
    let log = folder.log();
    (found < expected).then(|| {
        format!(
            "{}: expected {expected} episodes, as summary.json has them, found {found}",
            log.display()
        )
    })
}
