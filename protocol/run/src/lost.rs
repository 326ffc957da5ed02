//! What a run's log has lost.

use mcap_log::RunReader;

use crate::folder::RunFolder;
use crate::summary::Summary;

/// Returns a line for each file that could not be read in full, and one if the log lacks episodes
/// of a finished run. A file that is being written has lost nothing.
pub fn of_log(folder: &RunFolder, log: &RunReader) -> Vec<String> {
    let lost = log.endings().iter().filter(|(_, ending)| ending.lost());
    let files = lost.map(|(path, ending)| format!("{}: {ending}", path.display()));
    files.chain(of_episodes(folder, log.trajectories())).collect()
}

/// Returns a line if `found` is less than the number of episodes in a finished run's summary: whole
/// files may be missing.
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
