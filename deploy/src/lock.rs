//! The lock of a run's folder. Its file says who holds it, so that other commands can name the process, also from
//! another machine.

use std::fs::{self, File, TryLockError};
use std::os::unix::fs::FileExt;

use anyhow::{Context, Result};
use protocol::durable;
use run::folder::RunFolder;
use run::holder::{Holder, Work};
use rustix::process::Pid;
use terminal::refusal::wrong_usage;

use crate::listening::node_name;

/// Bytes of an earlier holder's text to overwrite at most.
const LONGEST: usize = 1 << 16;

/// The lock of a run's folder, held until this is dropped.
#[derive(Debug)]
pub(crate) struct Lock {
    file: File,
    holder: Holder,
}

impl Lock {
    /// Locks a run's folder against every other process that works on the run.
    ///
    /// # Errors
    /// When another process holds the lock, which is wrong usage, or the file cannot be written.
    pub(crate) fn take(folder: &RunFolder, work: Work) -> Result<Lock> {
        let path = folder.lock_file();
        // Opened for writing, because otherwise NFS grants no exclusive lock.
        let opened =
            File::options().read(true).write(true).create(true).truncate(false).open(&path);
        let file = opened.with_context(|| format!("opening {}", path.display()))?;
        match durable::try_lock(&file) {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Err(wrong_usage(in_use(folder))),
            Err(TryLockError::Error(error)) => {
                return Err(error).with_context(|| format!("locking {}", path.display()));
            }
        }
        let process = Some(std::process::id());
        let holder = Holder { work, process, machine: node_name(), failure: None };
        let lock = Lock { file, holder };
        lock.tell().with_context(|| format!("writing {}", path.display()))?;
        Ok(lock)
    }

    /// Keeps for other commands why the work failed.
    pub(crate) fn keep_failure(&mut self, failure: String) {
        self.holder.failure = Some(failure);
        if let Err(error) = self.tell() {
            tracing::debug!("the lock file does not say why the work failed: {error}");
        }
    }

    /// Writes the holder with one call, so that nobody reads it mixed with an earlier one: what is left of that becomes
    /// white space.
    fn tell(&self) -> std::io::Result<()> {
        let text = serde_json::to_string(&self.holder)?;
        let length = usize::try_from(self.file.metadata()?.len()).unwrap_or(0).min(LONGEST);
        self.file.write_all_at(format!("{text:length$}").as_bytes(), 0)
    }
}

fn in_use(folder: &RunFolder) -> String {
    let holder = folder.last_holder();
    let (shown, work) = (folder.path().display(), holder.work.done_to_it());
    format!("the run in {shown} is being {work} right now by {}", holder.shown())
}

/// Checks that no process works on a run.
///
/// # Errors
/// Wrong usage, when one does.
pub(crate) fn refuse_use(folder: &RunFolder) -> Result<()> {
    if folder.holder().is_some() { Err(wrong_usage(in_use(folder))) } else { Ok(()) }
}

/// Returns the process that trains a run.
///
/// # Errors
/// Wrong usage, when nobody trains it; `otherwise` says what the user can do then.
pub(crate) fn trainer(folder: &RunFolder, otherwise: &str) -> Result<Holder> {
    let found = match folder.holder() {
        Some(holder) if holder.work == Work::Training => return Ok(holder),
        Some(holder) => {
            format!("one that is being {} by {}", holder.work.done_to_it(), holder.shown())
        }
        None => "one that is not".to_owned(),
    };
    let shown = folder.path().display();
    Err(wrong_usage(format!("{shown}: expected a run that is training, found {found}{otherwise}")))
}

/// Returns the id of the process that holds the lock of a run, if this process can see it hold the file.
///
/// # Errors
/// When the process is on another machine, in another container or of another user.
pub(crate) fn process_here(folder: &RunFolder, holder: &Holder) -> Result<Pid> {
    let process = holder.process.filter(|id| has_open(*id, folder).unwrap_or(false));
    let id = process.and_then(|id| Pid::from_raw(i32::try_from(id).ok()?));
    id.with_context(|| {
        format!(
            "{}: expected its trainer among the processes of this machine and user, found {}",
            folder.path().display(),
            holder.shown()
        )
    })
}

/// Returns whether a process has the lock file of a run open. The same number may be another process's in another
/// container or on another machine.
fn has_open(process: u32, folder: &RunFolder) -> std::io::Result<bool> {
    let wanted = fs::metadata(folder.lock_file())?;
    let is_it = |found| durable::identity(&found) == durable::identity(&wanted);
    let open = fs::read_dir(format!("/proc/{process}/fd"))?;
    Ok(open.flatten().any(|entry| fs::metadata(entry.path()).is_ok_and(is_it)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lock_names_its_holder_and_why_it_failed() {
        let directory = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(directory.path());
        let mut lock = Lock::take(&folder, Work::Publishing).unwrap();
        let refused = Lock::take(&folder, Work::Training).unwrap_err().to_string();
        let own = format!("is being published right now by process {}", std::process::id());
        assert!(refused.contains(&own), "{refused}");
        assert!(refuse_use(&folder).is_err() && !folder.is_trained());
        let refused = trainer(&folder, "; nothing").unwrap_err().to_string();
        assert!(refused.contains("found one that is being published by process"), "{refused}");

        let holder = folder.holder().unwrap();
        assert_eq!(
            process_here(&folder, &holder).unwrap().as_raw_nonzero().get() as u32,
            std::process::id()
        );
        let other = Holder { process: Some(1), ..holder };
        let refused = process_here(&folder, &other).unwrap_err().to_string();
        assert!(refused.contains("found process 1 on"), "{refused}");

        lock.keep_failure("the disk is full".to_owned());
        drop(lock);
        assert_eq!(folder.holder(), None);
        refuse_use(&folder).unwrap();
        assert_eq!(folder.last_holder().failure.as_deref(), Some("the disk is full"));
        drop(Lock::take(&folder, Work::Training).unwrap());
        assert_eq!(folder.last_holder().failure, None, "the next holder has not failed");
    }
}
