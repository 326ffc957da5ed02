//! Which run is trained: a new one in a folder of its own, or one that is continued.
//!
//! Everything is checked before anything is written, so that a refusal leaves no trace.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use protocol::durable::{self, is_unfinished};
use run::actors_wanted::ActorsWanted;
use run::config::RunConfig;
use run::demonstrations::{existing_file_of, keep_copy};
use run::folder::RunFolder;
use run::holder::Work;
use run::repeat::quoted;
use run::summary::Summary;

use crate::lock::Lock;
use crate::tasks;
use crate::{demonstrations, destination, provenance};
use terminal::refusal::{Refusal, wrong_usage};

/// Parent folder of runs that were given no folder.
const RUNS: &str = "runs";

/// What the command line says about a run.
pub(crate) struct TrainRequest {
    /// Task, by its name or its file; if `None`, the default task.
    pub(crate) task: Option<String>,
    /// Preset; if `None`, the default preset.
    pub(crate) preset: Option<String>,
    /// Changes to the configuration, each `key=value`.
    pub(crate) settings: Vec<String>,
    /// Folder of the run; if `None`, a new one.
    pub(crate) folder: Option<PathBuf>,
}

/// A run that can start.
#[derive(Debug)]
pub(crate) struct PreparedRun {
    /// Folder of the run, which need not exist yet.
    pub(crate) folder: RunFolder,
    /// Effective configuration of the run.
    pub(crate) config: RunConfig,
    /// Whether the folder already holds the run.
    pub(crate) resumed: bool,
    /// Whether the folder has a number that may be replaced by another one.
    is_numbered: bool,
}

impl PreparedRun {
    /// Prepares a new run.
    ///
    /// # Errors
    /// When the configuration is invalid, or the folder is not free.
    pub(crate) fn new_run(wishes: TrainRequest) -> Result<PreparedRun> {
        let task = wishes.task.as_deref().unwrap_or(run::tasks::DEFAULT_TASK);
        let config = tasks::configuration(task, wishes.preset.as_deref(), &wishes.settings)?;
        if tasks::is_of_python(task) {
            tasks::remark_without_success(&config.task, &wishes.settings);
        }
        let config = demonstrations::adopt(with_absolute_paths(config, None)?, &wishes.settings)?;
        let is_numbered = wishes.folder.is_none();
        let path = wishes.folder.unwrap_or_else(|| next_free(Path::new(RUNS), &config.task.name));
        let folder = RunFolder::new(path);
        refuse_unless_free(&folder)?;
        destination::outside_runs(folder.path())?;
        Ok(PreparedRun { folder, config, resumed: false, is_numbered })
    }

    /// Prepares a new run with the configuration of another one.
    ///
    /// # Errors
    /// When the folder is not free.
    pub(crate) fn copy_of(config: RunConfig, folder: RunFolder) -> Result<PreparedRun> {
        refuse_unless_free(&folder)?;
        Ok(PreparedRun { folder, config, resumed: false, is_numbered: false })
    }

    /// Prepares the continuation of a run, with the configuration in its folder. Only keys that do not change the
    /// result can be changed.
    ///
    /// # Errors
    /// When the folder holds no run, or a request would change its result.
    pub(crate) fn resumed_run(wishes: TrainRequest) -> Result<PreparedRun> {
        let path = wishes
            .folder
            .ok_or_else(|| wrong_usage("expected the run to continue: --resume needs --run DIR"))?;
        let folder = RunFolder::new(path);
        let old = folder.config()?;
        refuse_unless_text(folder.path())?;
        provenance::refuse_if_changed(&folder, &old)?;
        // A finished run needs its demonstrations no more.
        if old.demonstrations.file.is_some() && !matches!(Summary::of_run(&folder), Ok(Some(_))) {
            existing_file_of(&folder, &old).map_err(Refusal::usage)?;
        }
        let refuse = |wish: &str| {
            let shown = folder.path().display();
            wrong_usage(format!(
                "{wish} would change the result of the run in {shown}, which can only be \
                 continued as it began; start a new run instead"
            ))
        };
        if let Some(task) = &wishes.task {
            let same = *task == old.task.name
                || tasks::configuration(task, None, &[])?.task.name == old.task.name;
            if !same {
                return Err(refuse("another task"));
            }
        }
        if wishes.preset.is_some_and(|preset| preset != old.preset) {
            return Err(refuse("another preset"));
        }
        for setting in &wishes.settings {
            if !changed(&old, std::slice::from_ref(setting))?.same_result_as(&old) {
                return Err(refuse(setting));
            }
        }
        // The number of actors set by `goalward scale` stays, unless the command line sets another one.
        let scaled = ActorsWanted::here(&folder).count().map_err(Refusal::usage)?;
        let scaled = scaled.map(|count| format!("resources.actors={count}"));
        let settings: Vec<String> = scaled.into_iter().chain(wishes.settings).collect();
        let config = changed(&old, &settings)?;
        Ok(PreparedRun { config, folder, resumed: true, is_numbered: false })
    }

    /// Creates the folder, takes its lock and writes the configuration into it.
    ///
    /// # Errors
    /// When another `goalward train` has the folder, or the files cannot be written.
    pub(crate) fn lay_out(&mut self) -> Result<Lock> {
        if self.is_numbered {
            self.take_number()?;
        }
        let failed = || format!("laying out the run in {}", self.folder.path().display());
        durable::create_folder(self.folder.path()).with_context(failed)?;
        let lock = Lock::take(&self.folder, Work::Training)?;
        if !self.resumed {
            // Another process may have begun a run here between the first check and the lock.
            refuse_unless_free(&self.folder)?;
        }
        self.clear().with_context(failed)?;
        // The configuration marks the beginning of a run: a folder without one is free.
        durable::write(&self.folder.config_file(), self.config.to_text()).with_context(failed)?;
        keep_copy(&self.folder, &self.config).context("copying the demonstrations")?;
        fs::create_dir_all(self.folder.output()).with_context(failed)?;
        ActorsWanted::here(&self.folder).forget()?;
        Ok(lock)
    }

    /// Creates the folder, with the next number if another process has created it in the meantime.
    fn take_number(&mut self) -> Result<()> {
        let runs = Path::new(RUNS);
        durable::create_folder(runs).context(RUNS)?;
        while let Err(error) = fs::create_dir(self.folder.path()) {
            if error.kind() != ErrorKind::AlreadyExists {
                return Err(error).with_context(|| self.folder.path().display().to_string());
            }
            self.folder = RunFolder::new(next_free(runs, &self.config.task.name));
        }
        Ok(())
    }

    /// Removes what an interrupted start left, and a summary that cannot be read.
    fn clear(&self) -> std::io::Result<()> {
        durable::clear(self.folder.path())?;
        if Summary::of_run(&self.folder).is_err() {
            fs::remove_file(self.folder.summary_file())?;
        }
        Ok(())
    }
}

/// Returns the default configuration of `task`, as the user names it, with the preset and method of `config`, which the
/// user has changed by `settings`.
///
/// # Errors
/// As [`PreparedRun::new_run`].
pub(crate) fn usual(task: &str, config: &RunConfig, settings: &[String]) -> Result<RunConfig> {
    let by_itself = [format!("method={}", config.method)];
    let preset = Some(config.preset.as_str());
    let usual = tasks::configuration(task, preset, &by_itself).or_else(|_| {
        // A Python environment may not exist without its settings.
        let of_environment = settings.iter().filter(|setting| setting.starts_with("environment."));
        let needed: Vec<String> = of_environment.chain(&by_itself).cloned().collect();
        tasks::configuration(task, preset, &needed)
    })?;
    let usual = demonstrations::adopt(with_absolute_paths(usual, None)?, &[])?;
    Ok(RunConfig { task: config.task.clone(), ..usual })
}

/// Returns `old` with `settings` applied.
///
/// # Errors
/// When the result is not a valid configuration.
pub(crate) fn changed(old: &RunConfig, settings: &[String]) -> Result<RunConfig> {
    with_absolute_paths(old.with_settings(settings)?, old.demonstrations.file.as_deref())
}

/// Makes the paths of a configuration absolute, so that the run can be continued from any folder. The demonstrations
/// that it `began_with` keep their name, since another name would be another setting; `file_of` finds them where they
/// are now.
fn with_absolute_paths(mut config: RunConfig, began_with: Option<&Path>) -> Result<RunConfig> {
    if let Some(file) = &mut config.demonstrations.file
        && began_with != Some(file.as_path())
    {
        *file = file
            .canonicalize()
            .map_err(|error| wrong_usage(format!("demonstrations {}: {error}", file.display())))?;
        refuse_unless_text(file)?;
    }
    if let Some(program) = &mut config.task.program {
        let shown = program.display();
        *program = program.canonicalize().map_err(|error| {
            wrong_usage(format!("the task's program {shown}, which its user builds: {error}"))
        })?;
        refuse_unless_text(program)?;
    }
    Ok(config)
}

/// Refuses a path that is not UTF-8, since a run's configuration and messages hold its paths as text.
fn refuse_unless_text(path: &Path) -> Result<()> {
    match destination::resolved(path)?.to_str() {
        Some(_) => Ok(()),
        None => Err(wrong_usage(format!("expected a path in UTF-8, found {}", path.display()))),
    }
}

fn refuse_unless_free(folder: &RunFolder) -> Result<()> {
    refuse_unless_text(folder.path())?;
    let path = folder.path();
    let shown = path.display();
    if folder.config_file().exists() {
        return Err(wrong_usage(format!(
            "{shown} already holds a run: continue it with --resume --run {}, or give another folder",
            quoted(path.display())
        )));
    }
    match fs::read_dir(path) {
        Ok(entries) => {
            let mut found = entries.flatten().map(|entry| entry.path());
            // A refused or interrupted start leaves these.
            if found.all(|path| is_unfinished(&path) || path == folder.lock_file()) {
                return Ok(());
            }
            Err(wrong_usage(format!(
                "expected a new or an empty folder for the run, found files in {shown}"
            )))
        }
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(()),
        Err(error) => {
            Err(Refusal::usage(anyhow::Error::from(error).context(format!("run folder {shown}")))
                .into())
        }
    }
}

/// Returns `RUNS/TASK-NUMBER`, with the number after the largest existing one.
fn next_free(runs: &Path, task: &str) -> PathBuf {
    let entries = fs::read_dir(runs).into_iter().flatten().flatten();
    let number = |name: &str| name.strip_prefix(task)?.strip_prefix('-')?.parse::<u32>().ok();
    let taken = entries.filter_map(|entry| number(entry.file_name().to_str()?));
    let next = taken.max().map_or(1, |last| last.saturating_add(1));
    runs.join(format!("{task}-{next:04}"))
}

#[cfg(test)]
mod tests {
    use std::fs::{File, TryLockError};

    use super::*;
    use mcap_log::{FileWriter, Kind, LogOptions, LogWriter, Metadata, Topic};
    use run::demonstrations::file_of;

    fn wishes(folder: &Path, settings: &[&str]) -> TrainRequest {
        TrainRequest {
            task: None,
            preset: None,
            settings: settings.iter().map(|&setting| setting.to_owned()).collect(),
            folder: Some(folder.to_owned()),
        }
    }

    fn demonstrations_in(file: &Path) -> String {
        let metadata = Metadata::new(Kind::Demonstrations, "navigation", 1);
        FileWriter::create(file, &metadata, &[Topic::Trajectory]).unwrap().seal().unwrap();
        format!("demonstrations.file={:?}", file.to_str().unwrap())
    }

    #[test]
    fn run_names_count_up() {
        let directory = tempfile::tempdir().unwrap();
        let runs = directory.path().join("runs");
        assert_eq!(next_free(&runs, "navigation"), runs.join("navigation-0001"));
        for name in ["navigation-0001", "navigation-0007", "navigation-x", "other-0009"] {
            fs::create_dir_all(runs.join(name)).unwrap();
        }
        assert_eq!(next_free(&runs, "navigation"), runs.join("navigation-0008"));
    }

    #[test]
    fn nothing_is_overwritten() {
        let directory = tempfile::tempdir().unwrap();
        let mut plan = PreparedRun::new_run(wishes(directory.path(), &["seed=3"])).unwrap();
        plan.lay_out().unwrap();
        assert_eq!(plan.folder.config().unwrap(), plan.config);
        let message = PreparedRun::new_run(wishes(directory.path(), &[])).unwrap_err().to_string();
        assert!(message.contains("--resume"), "{message}");

        let other = tempfile::tempdir().unwrap();
        fs::write(other.path().join("thesis.txt"), "dear").unwrap();
        let message = PreparedRun::new_run(wishes(other.path(), &[])).unwrap_err().to_string();
        assert!(message.contains("found files"), "{message}");
        let file = other.path().join("thesis.txt");
        assert!(PreparedRun::new_run(wishes(&file, &[])).is_err());
    }

    #[test]
    fn what_a_death_left_unfinished_is_cleared() {
        let directory = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(directory.path());
        let left = durable::unfinished(&folder.config_file());
        fs::write(&left, "seed = ").unwrap();
        PreparedRun::new_run(wishes(directory.path(), &[])).unwrap().lay_out().unwrap();
        assert!(!left.exists() && folder.config().is_ok());

        // A learner that an earlier start left behind may still be writing its checkpoint.
        let unfinished = durable::unfinished(&folder.checkpoint_folder(25));
        fs::create_dir_all(&unfinished).unwrap();
        fs::write(folder.summary_file(), "").unwrap();
        PreparedRun::resumed_run(wishes(directory.path(), &[])).unwrap().lay_out().unwrap();
        assert!(unfinished.exists() && !folder.summary_file().exists());
    }

    #[test]
    fn a_resumed_run_keeps_what_makes_its_result() {
        let directory = tempfile::tempdir().unwrap();
        let first = TrainRequest {
            preset: Some("paper".to_owned()),
            ..wishes(directory.path(), &["seed=3", "resources.actors=1"])
        };
        let mut first = PreparedRun::new_run(first).unwrap();
        first.lay_out().unwrap();

        let same = ["seed=3", "resources.actors=4"];
        let resumed = PreparedRun::resumed_run(wishes(directory.path(), &same)).unwrap();
        assert_eq!(resumed.config.resources.actors, 4);
        assert_eq!(resumed.config.preset, "paper");
        assert!(resumed.config.same_result_as(&first.config));

        let other =
            PreparedRun::resumed_run(wishes(directory.path(), &["ppo.clip=0.3"])).unwrap_err();
        assert!(other.to_string().contains("ppo.clip=0.3 would change"), "{other}");
        let preset =
            TrainRequest { preset: Some("authors".into()), ..wishes(directory.path(), &[]) };
        assert!(PreparedRun::resumed_run(preset).is_err());
    }

    #[test]
    fn a_run_is_continued_where_its_experiment_was_moved() {
        let directory = tempfile::tempdir().unwrap();
        let place = directory.path().canonicalize().unwrap();
        let [before, now] = ["before", "now"].map(|name| place.join(name));
        let shown = before.join("demonstrations/shown.mcap");
        fs::create_dir_all(before.join("demonstrations")).unwrap();
        let given = demonstrations_in(&shown);
        let mut first =
            PreparedRun::new_run(wishes(&before.join("runs/one"), &["seed=1", given.as_str()]))
                .unwrap();
        drop(first.lay_out().unwrap());
        let metadata = run::metadata::of_run(&first.config);
        let options = LogOptions::default();
        LogWriter::create(&first.folder.log(), &metadata, options).unwrap().finish().unwrap();
        fs::rename(&before, &now).unwrap();

        for _ in 0..2 {
            let folder = now.join("runs/one");
            let mut resumed = PreparedRun::resumed_run(wishes(&folder, &["seed=1"])).unwrap();
            assert!(resumed.config.same_result_as(&first.config));
            let found = file_of(&resumed.folder, &resumed.config);
            assert_eq!(found, now.join("demonstrations/shown.mcap"));
            drop(resumed.lay_out().unwrap());
        }
    }

    #[test]
    fn a_run_does_not_depend_on_the_file_of_its_demonstrations() {
        let directory = tempfile::tempdir().unwrap();
        let [folder, shown] = ["run", "shown.mcap"].map(|name| directory.path().join(name));
        let given = demonstrations_in(&shown);
        drop(PreparedRun::new_run(wishes(&folder, &[given.as_str()])).unwrap().lay_out().unwrap());
        fs::remove_file(&shown).unwrap();
        let resumed = PreparedRun::resumed_run(wishes(&folder, &[])).unwrap();
        let copy = file_of(&resumed.folder, &resumed.config);
        assert!(copy.is_file() && copy.starts_with(&folder), "{}", copy.display());
        fs::remove_file(&copy).unwrap();
        PreparedRun::resumed_run(wishes(&folder, &[])).expect_err("its demonstrations are gone");
    }

    #[test]
    fn a_resumed_run_keeps_the_actors_it_was_scaled_to() {
        let directory = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(directory.path());
        let mut first =
            PreparedRun::new_run(wishes(directory.path(), &["resources.actors=1"])).unwrap();
        drop(first.lay_out().unwrap());
        let resumed_with = |settings: &[&str]| {
            let mut resumed = PreparedRun::resumed_run(wishes(directory.path(), settings)).unwrap();
            drop(resumed.lay_out().unwrap());
            (resumed.config.resources.actors, folder.config().unwrap().resources.actors)
        };
        let wanted = ActorsWanted::here(&folder);
        wanted.want(2).unwrap();
        assert_eq!(resumed_with(&[]), (2, 2));
        assert_eq!(resumed_with(&[]), (2, 2), "it is in the configuration now");
        wanted.want(1).unwrap();
        assert_eq!(resumed_with(&["resources.actors=3"]), (3, 3));
        assert_eq!(resumed_with(&[]), (3, 3), "the older wish is forgotten");
    }

    #[test]
    fn a_run_has_one_trainer() {
        let directory = tempfile::tempdir().unwrap();
        // A refused start leaves its lock file.
        let folder = RunFolder::new(directory.path());
        drop(Lock::take(&folder, Work::Training).unwrap());
        let mut plan = PreparedRun::new_run(wishes(directory.path(), &[])).unwrap();
        let mut rival = PreparedRun::new_run(wishes(directory.path(), &[])).unwrap();
        assert!(!plan.folder.is_trained());
        let held = plan.lay_out().unwrap();
        assert!(rival.lay_out().unwrap_err().to_string().contains("being trained"));
        let rival_lock = Lock::take(&plan.folder, Work::Publishing);
        assert!(rival_lock.unwrap_err().to_string().contains("being trained"));
        let asked = File::open(directory.path().join("lock")).unwrap().try_lock_shared();
        assert!(matches!(asked, Err(TryLockError::WouldBlock)), "a file, which NFS can lock");
        assert!(plan.folder.is_trained());
        drop(held);
        assert!(!plan.folder.is_trained());
        drop(Lock::take(&plan.folder, Work::Repairing).unwrap());
        assert!(rival.lay_out().unwrap_err().to_string().contains("already holds"));
    }
}
