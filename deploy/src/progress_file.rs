//! The newest progress of a run in a file of its folder, for readers that are not on its bus: experiments and the page.
//! Losing it does no harm, so writing does not wait for the disk.

use std::fs;
use std::io;
use std::time::Duration;

use prost::Message;
use protocol::durable;
use protocol::messages::Progress;
use run::folder::RunFolder;

/// Replaces the progress of a run.
///
/// # Errors
/// When the file cannot be written; the earlier one then stays.
pub(crate) fn write(folder: &RunFolder, progress: &Progress) -> io::Result<()> {
    durable::write_unsynced(&folder.progress_file(), progress.encode_to_vec())
}

/// Reads the newest progress since the run was last started; `None` if there is none yet.
pub(crate) fn read(folder: &RunFolder) -> Option<Progress> {
    Progress::decode(&*fs::read(folder.progress_file()).ok()?).ok()
}

/// Returns the time since the progress was written.
pub(crate) fn age(folder: &RunFolder) -> Duration {
    let told = fs::metadata(folder.progress_file()).and_then(|file| file.modified());
    told.ok().and_then(|told| told.elapsed().ok()).unwrap_or_default()
}

/// Removes the progress of an earlier start.
pub(crate) fn clear(folder: &RunFolder) {
    fs::remove_file(folder.progress_file()).ok();
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_progress_is_read() {
        let directory = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(directory.path());
        fs::create_dir(folder.output()).unwrap();
        assert_eq!(read(&folder), None);
        for steps_wanted in [3, 4] {
            let progress = Progress { steps_wanted, ..Progress::default() };
            write(&folder, &progress).unwrap();
            assert_eq!(read(&folder), Some(progress));
        }
        fs::write(folder.progress_file(), [7; 9]).unwrap();
        assert_eq!(read(&folder), None, "what is no progress is passed over");
        clear(&folder);
        assert_eq!(fs::read_dir(folder.output()).unwrap().count(), 0);
    }
}
