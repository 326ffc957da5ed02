//! The TensorBoard event file that `goalward train` writes from the log during training, on a thread of its own, so
//! that a slow disk delays nothing.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, RecvTimeoutError, SyncSender};
use std::thread::{Builder, JoinHandle};
use std::time::Duration;

use anyhow::{Context, Result};
use report::TensorBoard;
use run::folder::RunFolder;
use run::summary::Summary;
use terminal::print::print_remark;

/// Time between two looks at the log.
const EVERY: Duration = Duration::from_secs(2);

/// Returns the folder of a run's event file within `folder`, which several runs may share.
pub(crate) fn of_run(run: &RunFolder, folder: &Path) -> Result<PathBuf> {
    let shown = || format!("{}: expected a folder with a name", run.path().display());
    let path = run.path().canonicalize().with_context(shown)?;
    Ok(folder.join(path.file_name().with_context(shown)?))
}

/// An event file that is written while a run trains.
pub(crate) struct EventFiles {
    end: SyncSender<()>,
    writer: Option<JoinHandle<()>>,
}

impl EventFiles {
    /// Starts to write the event file of a run within `folder`.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub(crate) fn start(run: &RunFolder, folder: &Path) -> Result<EventFiles> {
        let mut file = TensorBoard::of(run.clone(), &of_run(run, folder)?)?;
        let run = run.clone();
        let (end, ended) = mpsc::sync_channel(0);
        let write = move || {
            while ended.recv_timeout(EVERY) == Err(RecvTimeoutError::Timeout) {
                tell(file.go_on());
            }
            let summary = Summary::of_run(&run).unwrap_or(None);
            tell(match summary {
                Some(summary) => file.end(&summary),
                None => file.go_on(),
            });
        };
        let writer = Builder::new().name("event-files".to_owned()).spawn(write)?;
        Ok(EventFiles { end, writer: Some(writer) })
    }
}

impl Drop for EventFiles {
    fn drop(&mut self) {
        self.end.send(()).ok();
        self.writer.take().map(JoinHandle::join);
    }
}

/// Reports a failed write. What is missing is written the next time, or by `goalward report` when the run is over.
fn tell(written: Result<()>) {
    if let Err(error) = written {
        print_remark(&format!(
            "the event file for TensorBoard lacks the newest updates: {error:#}"
        ));
    }
}
