//! The TensorBoard event file that `goalward train` writes from the log during training, on a thread of its own, so
//! that a slow disk delays nothing.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, RecvTimeoutError, SyncSender};
use std::thread::{Builder, JoinHandle};
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use report::TensorBoard;
use run::folder::RunFolder;
use run::summary::Summary;
use terminal::print::print_remark;
use terminal::refusal::wrong_usage;

use crate::destination;

/// Time between two looks at the log.
const EVERY: Duration = Duration::from_secs(2);

/// Returns the folder of a run's event file within `folder`, which several runs may share.
///
/// # Errors
/// Wrong usage, when it would be in the folder of a run, which need not exist yet.
pub(crate) fn of_run(run: &RunFolder, folder: &Path) -> Result<PathBuf> {
    let path = destination::resolved(run.path())?;
    let name = path.file_name();
    let place = folder.join(name.with_context(|| format!("{}: expected a name", path.display()))?);
    destination::outside_runs(&place)?;
    if destination::resolved(&place)?.starts_with(&path) {
        return Err(wrong_usage(format!(
            "--tensorboard: expected a place outside of runs, found {}, the folder of the run itself",
            place.display()
        )));
    }
    Ok(place)
}

/// Checks that a run's event file may be written within `folder`, where it replaces only the same run's.
///
/// # Errors
/// Wrong usage, as [`of_run`], or when there is one of its name.
pub(crate) fn check(run: &RunFolder, folder: &Path, is_resumed: bool) -> Result<()> {
    destination::folder(folder, true)?;
    let place = of_run(run, folder)?;
    let is_empty = fs::read_dir(&place).map_or(true, |mut entries| entries.next().is_none());
    let is_own = is_resumed && TensorBoard::is_of(run, &place);
    let shown = place.display();
    ensure!(
        is_empty || is_own,
        wrong_usage(format!(
            "--tensorboard: expected no {shown} yet, found curves that are not known to be this run's"
        ))
    );
    Ok(())
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
            let mut told = String::new();
            while ended.recv_timeout(EVERY) == Err(RecvTimeoutError::Timeout) {
                tell(file.go_on(), &mut told);
            }
            let summary = Summary::of_run(&run).unwrap_or(None);
            let written = match summary {
                Some(summary) => file.end(&summary),
                None => file.go_on(),
            };
            tell(written, &mut told);
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

/// Reports a failed write, once while it fails for the same reason. What is missing is written the next time, or by
/// `goalward report` when the run is over.
fn tell(written: Result<()>, told: &mut String) {
    let why = written.err().map_or_else(String::new, |error| format!("{error:#}"));
    if !why.is_empty() && why != *told {
        print_remark(&format!("the event file for TensorBoard lacks the newest updates: {why}"));
    }
    *told = why;
}

#[cfg(test)]
mod tests {
    use run::tasks::configuration;

    use super::*;

    #[test]
    fn curves_replace_none_of_another_run_and_lie_in_no_run() {
        let directory = tempfile::tempdir().unwrap();
        let [runs, curves] = ["runs", "curves"].map(|name| directory.path().join(name));
        let run = RunFolder::new(runs.join("one"));
        check(&run, &curves, false).unwrap();
        let refused = check(&run, &runs, false).unwrap_err().to_string();
        assert!(refused.contains("the folder of the run itself"), "{refused}");
        fs::create_dir_all(curves.join("one")).unwrap();
        check(&run, &curves, false).unwrap();
        fs::write(curves.join("one/events"), "").unwrap();
        let refused = check(&run, &curves, false).unwrap_err().to_string();
        assert!(refused.contains("not known to be this run's"), "{refused}");
        assert!(check(&run, &curves, true).is_err(), "nobody knows whose they are");
        let namesake = RunFolder::new(directory.path().join("others/one"));
        for (run, seed) in [(&run, 1), (&namesake, 2)] {
            let config = configuration("navigation", None, &[format!("seed={seed}")]).unwrap();
            fs::create_dir_all(run.path()).unwrap();
            fs::write(run.config_file(), config.to_text()).unwrap();
        }
        TensorBoard::of(run.clone(), &curves.join("one")).unwrap();
        check(&run, &curves, true).unwrap();
        assert!(check(&namesake, &curves, true).is_err());
        fs::rename(directory.path().join("runs"), directory.path().join("moved")).unwrap();
        check(&RunFolder::new(directory.path().join("moved/one")), &curves, true).unwrap();
    }
}
