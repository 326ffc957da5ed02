//! Finds the checkpoint that a run resumes from: the newest intact one. A checkpoint is intact if
//! each of its files is the one that was saved according to the log, and has only finite numbers.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use mcap_log::{Contents, Ending, Record, log_files, read_contents};
use protocol::messages::Checkpoint as Recorded;
use protocol::tensors::Tensors;
use protocol::weights::Weights;
use protocol::{Error, build, digest, durable};

use crate::folder::{CHECKPOINT_FILES, LEARNER_FILE, POLICY_FILE, RunFolder};

/// Extension of a checkpoint's folder that has been set aside.
const DAMAGED: &str = "damaged";

/// An intact checkpoint.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Checkpoint {
    /// Number of iterations finished.
    pub iteration: u64,
    /// Its folder.
    pub folder: PathBuf,
}

impl Checkpoint {
    /// Reads one of its files.
    ///
    /// # Errors
    /// [`Error::Checkpoint`] if it cannot be read.
    pub fn load(&self, name: &str) -> Result<Tensors, Error> {
        Tensors::load(&self.folder.join(name))
    }

    /// Reads its policy.
    ///
    /// # Errors
    /// [`Error::Checkpoint`] if it cannot be read.
    pub fn policy(&self) -> Result<Weights, Error> {
        let failed = |message| Error::Checkpoint { path: self.folder.join(POLICY_FILE), message };
        Weights::from_tensors(&self.load(POLICY_FILE)?).map_err(failed)
    }
}

/// The newest intact checkpoint, and newer ones that were passed over.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NewestCheckpoint {
    /// The checkpoint to resume from; `None` if the run starts over.
    pub newest: Option<Checkpoint>,
    /// The folders passed over and what is wrong with each, newest first.
    pub damaged: Vec<(PathBuf, Error)>,
}

impl NewestCheckpoint {
    /// Returns what the user should know: a line for each checkpoint passed over, and that the run
    /// starts over if none is left.
    pub fn remarks(&self) -> Vec<String> {
        let mut lines: Vec<String> =
            self.damaged.iter().map(|(_, error)| format!("not used: {error}")).collect();
        if let (Some(last), None) = (lines.last_mut(), &self.newest) {
            last.push_str("; no checkpoint is left: the run starts over");
        }
        lines
    }
}

/// Finds the newest checkpoint whose `files` are intact. A caller that needs only the policy need not check the others.
///
/// # Errors
/// If there is a log but it cannot be read, or its damage hides the record of a checkpoint.
pub fn newest(run: &RunFolder, files: &[&str]) -> Result<NewestCheckpoint, Error> {
    let mut found = NewestCheckpoint::default();
    let folders = run.checkpoint_folders();
    if folders.is_empty() {
        return Ok(found);
    }
    let recorded = recorded(run)?;
    for (iteration, folder) in folders.into_iter().rev() {
        let held_to = recorded.as_ref().map(|records| records.of(iteration)).transpose()?;
        match files.iter().try_for_each(|name| check(&folder, name, held_to)) {
            Ok(()) => {
                found.newest = Some(Checkpoint { iteration, folder });
                break;
            }
            Err(error) => found.damaged.push((folder, error)),
        }
    }
    Ok(found)
}

/// Returns the checkpoint after `iteration` iterations, or else the newest one, whose `files` are
/// intact. Warns of each checkpoint that was passed over.
///
/// # Errors
/// [`Error::Checkpoint`] if there is none, or not the one asked for, or that one is not intact. Also
/// fails if there is a log but it cannot be read.
pub fn chosen(
    run: &RunFolder,
    iteration: Option<u64>,
    files: &[&str],
) -> Result<Checkpoint, Error> {
    let kept: Vec<u64> = run.checkpoint_folders().into_iter().map(|(number, _)| number).collect();
    let missing = |message| Err(Error::Checkpoint { path: run.checkpoints(), message });
    if kept.is_empty() {
        let first = run.config()?.checkpoint.iterations;
        return missing(format!(
            "expected a checkpoint, found none yet: the first one is after {first} iterations \
             (checkpoint.iterations)"
        ));
    }
    let Some(iteration) = iteration else {
        let found = newest(run, files)?;
        found.damaged.iter().for_each(|(_, error)| tracing::warn!("not used: {error}"));
        let message = "expected an intact checkpoint, found none".to_owned();
        return found.newest.ok_or(Error::Checkpoint { path: run.checkpoints(), message });
    };
    if !kept.contains(&iteration) {
        let kept = kept.iter().map(u64::to_string).collect::<Vec<_>>().join(", ");
        return missing(format!("expected one of the checkpoints {kept}, found {iteration}"));
    }
    let folder = run.checkpoint_folder(iteration);
    let recorded = recorded(run)?;
    let held_to = recorded.as_ref().map(|records| records.of(iteration)).transpose()?;
    files.iter().try_for_each(|name| check(&folder, name, held_to))?;
    Ok(Checkpoint { iteration, folder })
}

/// Finds the newest checkpoint whose files are all intact. Those passed over are set aside, so that
/// they can be saved again, and unfinished ones are removed: nobody may be writing one.
///
/// # Errors
/// As [`newest`], and [`Error::Checkpoint`] if a folder cannot be renamed or removed.
pub fn settle(run: &RunFolder) -> Result<NewestCheckpoint, Error> {
    durable::clear(&run.checkpoints()).map_err(|cause| {
        let message = format!("what is unfinished cannot be removed: {cause}");
        Error::Checkpoint { path: run.checkpoints(), message }
    })?;
    let found = newest(run, &CHECKPOINT_FILES)?;
    for (folder, _) in &found.damaged {
        let aside = folder.with_extension(DAMAGED);
        let cleared = match aside.exists() {
            true => durable::remove_folder(&aside),
            false => Ok(()),
        };
        cleared.and_then(|()| durable::rename(folder, &aside)).map_err(|cause| {
            let message = format!("cannot be laid aside as {}: {cause}", aside.display());
            Error::Checkpoint { path: folder.clone(), message }
        })?;
    }
    Ok(found)
}

/// The log's records of checkpoints.
struct Records {
    by_iteration: BTreeMap<u64, Recorded>,
    /// Damage behind which there may be more of them.
    damage: Option<(PathBuf, Ending)>,
}

impl Records {
    /// Returns the record of the checkpoint after `iteration` iterations; `None` if the log has none.
    fn of(&self, iteration: u64) -> Result<Option<&Recorded>, Error> {
        match (self.by_iteration.get(&iteration), &self.damage) {
            (None, Some((path, ending))) => {
                let message = format!(
                    "{ending}; the record of checkpoint {iteration} may be behind that: `goalward log repair` keeps \
                     whatever can be read"
                );
                Err(Error::LogRead { path: path.clone(), message })
            }
            (record, _) => Ok(record),
        }
    }
}

/// Returns the log's records of checkpoints; `None` if there is no log.
fn recorded(run: &RunFolder) -> Result<Option<Records>, Error> {
    let files = match log_files(&run.log()) {
        Err(_) if run.log().try_exists().is_ok_and(|exists| !exists) => return Ok(None),
        files => files?,
    };
    if files.iter().all(|file| file.contents != Contents::Updates) {
        return Ok(None);
    }
    let log = read_contents(&run.log(), Contents::Updates)?;
    let is_damaged = |(_, ending): &&(PathBuf, Ending)| matches!(ending, Ending::Corrupt { .. });
    let damage = log.endings().iter().find(is_damaged).cloned();
    let mut by_iteration = BTreeMap::new();
    for entry in log {
        if let Record::Checkpoint(checkpoint) = entry?.record {
            by_iteration.insert(checkpoint.iteration, checkpoint);
        }
    }
    Ok(Some(Records { by_iteration, damage }))
}

/// Checks a file against the log's record of its checkpoint, if there is a log.
fn check(folder: &Path, name: &str, held_to: Option<Option<&Recorded>>) -> Result<(), Error> {
    let path = folder.join(name);
    let failed = |message: String| Error::Checkpoint { path: path.clone(), message };
    let bytes = fs::read(&path).map_err(|cause| failed(cause.to_string()))?;
    match held_to {
        Some(None) => return Err(failed("expected its record in the log, found none".to_owned())),
        Some(Some(recorded)) => hold_to(recorded, name, &bytes).map_err(failed)?,
        None => {}
    }
    let tensors = Tensors::from_file(&bytes).map_err(failed)?;
    tensors.expect_finite().map_err(failed)
}

fn hold_to(recorded: &Recorded, name: &str, bytes: &[u8]) -> Result<(), String> {
    let of_file = match name {
        POLICY_FILE => &recorded.policy_file_sha256,
        LEARNER_FILE => &recorded.learner_file_sha256,
        _ => &recorded.proximity_file_sha256,
    };
    let (what, expected, found) = if of_file.is_empty() {
        let tensors = Tensors::from_file(bytes)?;
        match name {
            POLICY_FILE => {
                ("weights", &recorded.policy_sha256, Weights::from_tensors(&tensors)?.sha256())
            }
            LEARNER_FILE => ("weights", &recorded.policy_sha256, learners_policy(&tensors)?),
            _ => ("weights", &recorded.proximity_sha256, members(&tensors)),
        }
    } else {
        ("a file", of_file, digest::sha256([bytes]))
    };
    if *expected == found {
        return Ok(());
    }
    let [expected, found] = [expected, &found].map(|hash| build::short(hash));
    Err(format!("expected {what} of SHA-256 {expected}... as in the log, found {found}..."))
}

/// Returns the hash of the policy in a learner's file.
fn learners_policy(tensors: &Tensors) -> Result<String, String> {
    let parameters = tensors.f32("policy.parameters")?;
    Ok(Weights::new(0, &parameters, &tensors.f64("policy.moments")?).sha256())
}

/// Returns the hash of the ensemble in a proximity service's file.
fn members(tensors: &Tensors) -> String {
    let member = |number| tensors.f32_bytes(&format!("member{number}.parameters")).ok();
    digest::sha256((0..).map_while(member))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::folder::PROXIMITY_FILE;
    use mcap_log::{Kind, LogOptions, LogWriter, Metadata};

    fn run(iterations: &[u64], records: impl Fn(Recorded) -> Recorded) -> tempfile::TempDir {
        let home = tempfile::tempdir().unwrap();
        let run = RunFolder::new(home.path());
        let metadata = Metadata::new(Kind::Run, "navigation", 1);
        let mut log = LogWriter::create(&run.log(), &metadata, LogOptions::default()).unwrap();
        for &iteration in iterations {
            let folder = run.checkpoint_folder(iteration);
            fs::create_dir_all(&folder).unwrap();
            let number = iteration as f32;
            let policy = Weights::new(iteration, &[number, 1.0], &[2.0]);
            let mut learner = Tensors::default();
            learner.put_f32("policy.parameters", [number, 1.0]);
            learner.put_f64("policy.moments", [2.0]);
            let mut proximity = Tensors::default();
            proximity.put_f32("member0.parameters", [number]);
            proximity.put_f32("member1.parameters", [1.0]);
            log.checkpoint(&records(Recorded {
                iteration,
                path: String::new(),
                policy_sha256: policy.sha256(),
                proximity_sha256: members(&proximity),
                policy_file_sha256: policy.save(&folder.join(POLICY_FILE)).unwrap(),
                learner_file_sha256: learner.save(&folder.join(LEARNER_FILE)).unwrap(),
                proximity_file_sha256: proximity.save(&folder.join(PROXIMITY_FILE)).unwrap(),
            }))
            .unwrap();
        }
        log.finish().unwrap();
        home
    }

    fn of_older_builds(recorded: Recorded) -> Recorded {
        let [policy_file_sha256, learner_file_sha256, proximity_file_sha256] =
            [(); 3].map(|()| String::new());
        Recorded { policy_file_sha256, learner_file_sha256, proximity_file_sha256, ..recorded }
    }

    fn newest_of(run: &RunFolder) -> Option<u64> {
        Some(newest(run, &CHECKPOINT_FILES).unwrap().newest?.iteration)
    }

    /// Damages a file of the checkpoint after 8 iterations.
    fn damage(run: &RunFolder, name: &str, how: impl Fn(Vec<u8>) -> Vec<u8>) {
        let path = run.checkpoint_folder(8).join(name);
        let bytes = fs::read(&path).unwrap();
        fs::write(&path, how(bytes)).unwrap();
    }

    fn flip(mut bytes: Vec<u8>) -> Vec<u8> {
        // The third-last byte belongs to a number.
        let at = bytes.len() - 3;
        bytes[at] ^= 1;
        bytes
    }

    fn put_nan(mut bytes: Vec<u8>) -> Vec<u8> {
        let at = bytes.len() - 4;
        bytes[at..].copy_from_slice(&f32::NAN.to_le_bytes());
        bytes
    }

    fn halve(mut bytes: Vec<u8>) -> Vec<u8> {
        bytes.truncate(bytes.len() / 2);
        bytes
    }

    #[test]
    fn a_damaged_checkpoint_is_passed_over_whatever_file_and_damage_it_is() {
        for records in [std::convert::identity as fn(Recorded) -> Recorded, of_older_builds] {
            for name in CHECKPOINT_FILES {
                for how in [flip as fn(Vec<u8>) -> Vec<u8>, put_nan, halve] {
                    let home = run(&[4, 8], records);
                    let run = RunFolder::new(home.path());
                    assert_eq!(newest_of(&run), Some(8));
                    damage(&run, name, how);
                    let found = newest(&run, &CHECKPOINT_FILES).unwrap();
                    assert_eq!(found.newest.as_ref().unwrap().iteration, 4, "{name}");
                    let remarks = found.remarks();
                    assert!(remarks.len() == 1 && remarks[0].contains(name), "{remarks:?}");
                    let others: Vec<_> =
                        CHECKPOINT_FILES.into_iter().filter(|other| *other != name).collect();
                    assert_eq!(newest(&run, &others).unwrap().newest.unwrap().iteration, 8);
                }
            }
        }
    }

    #[test]
    fn a_checkpoint_that_is_asked_for_holds_or_is_refused() {
        let home = run(&[4, 8], |recorded| recorded);
        let run = RunFolder::new(home.path());
        let chosen = |iteration| chosen(&run, iteration, &[POLICY_FILE]);
        damage(&run, POLICY_FILE, flip);
        assert_eq!(chosen(None).unwrap().iteration, 4);
        assert_eq!(chosen(Some(4)).unwrap().policy().unwrap().version, 4);
        assert!(chosen(Some(8)).unwrap_err().to_string().contains("SHA-256"));
        let said = chosen(Some(5)).unwrap_err().to_string();
        assert!(said.ends_with("expected one of the checkpoints 4, 8, found 5"), "{said}");
    }

    #[test]
    fn a_run_without_a_checkpoint_says_when_the_first_one_comes() {
        let home = tempfile::tempdir().unwrap();
        let run = RunFolder::new(home.path());
        let settings = ["checkpoint.iterations=7".to_owned()];
        let config = crate::tasks::configuration("navigation", None, &settings).unwrap();
        fs::write(run.config_file(), config.to_text()).unwrap();
        for iteration in [None, Some(7)] {
            let said = chosen(&run, iteration, &[POLICY_FILE]).unwrap_err().to_string();
            assert!(said.contains("found none yet: the first one is after 7"), "{said}");
        }
    }

    #[test]
    fn what_is_passed_over_is_laid_aside_and_the_last_one_too() {
        let home = run(&[4, 8], |recorded| recorded);
        let run = RunFolder::new(home.path());
        for iteration in [4, 8] {
            fs::remove_file(run.checkpoint_folder(iteration).join(LEARNER_FILE)).unwrap();
        }
        let unfinished = durable::unfinished(&run.checkpoint_folder(12));
        fs::create_dir(&unfinished).unwrap();
        let found = settle(&run).unwrap();
        assert!(!unfinished.exists());
        assert_eq!((found.newest.as_ref(), found.damaged.len()), (None, 2));
        assert!(found.remarks()[1].ends_with("the run starts over"), "{:?}", found.remarks());
        assert!(run.checkpoint_folders().is_empty());
        assert!(run.checkpoints().join("000008.damaged").exists());
        assert_eq!(settle(&run).unwrap(), NewestCheckpoint::default());
    }

    #[test]
    fn a_checkpoint_is_not_passed_over_for_damage_of_the_log_that_a_repair_mends() {
        let home = run(&[4, 8], |recorded| recorded);
        let run = RunFolder::new(home.path());
        let file = run.log().join("updates-00000.mcap");
        let bytes = fs::read(&file).unwrap();
        let refusal = |at: usize| {
            let mut damaged = bytes.clone();
            damaged[at] ^= 0xff;
            fs::write(&file, damaged).unwrap();
            newest(&run, &CHECKPOINT_FILES).err().map(|error| error.to_string())
        };
        // Some of the bytes are in the chunk that has the records.
        let mut refusals = (0..bytes.len()).step_by(8).filter_map(refusal);
        assert!(refusals.any(|said| said.contains("`goalward log repair`")));
        assert_eq!(run.checkpoint_folders().len(), 2);
        mcap_log::repair(&file).unwrap();
        newest(&run, &CHECKPOINT_FILES).unwrap();
    }

    #[test]
    fn a_checkpoint_that_the_log_does_not_have_is_passed_over_unless_there_is_no_log() {
        let home = run(&[4, 8], |recorded| recorded);
        let run = RunFolder::new(home.path());
        fs::rename(run.checkpoint_folder(8), run.checkpoint_folder(9)).unwrap();
        let found = newest(&run, &CHECKPOINT_FILES).unwrap();
        assert!(found.remarks()[0].contains("found none"), "{:?}", found.remarks());
        assert_eq!(found.newest.unwrap().iteration, 4);
        fs::remove_dir_all(run.log()).unwrap();
        assert_eq!(newest_of(&run), Some(9));
        fs::write(run.log(), "").unwrap();
        newest(&run, &CHECKPOINT_FILES).expect_err("a log that cannot be read is a log");
    }
}
