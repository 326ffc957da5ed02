//! The state of a run, for people.

use std::path::Path;

use protocol::messages::{Phase, PolicyUpdate, Progress};
use run::config::RunConfig;
use run::folder::RunFolder;
use run::holder::Holder;
use run::hosts::Expelled;

use super::{PATIENCE, Standing, Status, Stopped};
use crate::processes::Processes;
use crate::progress::offline;
use crate::summary::{self, times_to_success};
use terminal::numbers;

const NEWEST_CHECKPOINT: &str = "newest checkpoint";

impl Status {
    /// Returns a headline and a table.
    pub(super) fn table(&self) -> String {
        let config = &self.config;
        match &self.standing {
            Standing::Live { processes, progress, times, hosts } => {
                let mut rows = match progress {
                    Some(progress) => live_rows(progress, config),
                    None => common_rows(config),
                };
                rows.extend(checkpoint_row(&self.folder));
                rows.extend(times_to_success(times));
                rows.extend(hosts.present.iter().map(|host| ("host", host.line())));
                let expelled = |one: &Expelled| format!("{}: {}", one.name, one.why);
                rows.extend(hosts.expelled.iter().map(|one| ("expelled", expelled(one))));
                let heard = progress.as_ref().map_or(&[][..], |progress| &progress.actors_heard);
                let trouble = trouble(processes, progress.as_deref());
                let headline = trouble.unwrap_or_else(|| "training".to_owned());
                format!("{headline}\n{}{}", numbers::table(&rows), processes.table(heard))
            }
            Standing::Finished(summary) => format!("finished\n{}", summary::table(summary)),
            Standing::Beginning { records } => {
                let doing = match records {
                    true => "recording its demonstrations",
                    false => "its processes are not there yet",
                };
                format!("starting: {doing}\n{}", numbers::table(&common_rows(config)))
            }
            Standing::Elsewhere { trainer, progress, age, times } => {
                let mut rows = match progress {
                    Some(progress) => live_rows(progress, config),
                    None => common_rows(config),
                };
                if progress.is_some() {
                    rows.push(("told", format!("{} ago", numbers::duration(age.as_secs_f64()))));
                }
                rows.extend(checkpoint_row(&self.folder));
                rows.extend(times_to_success(times));
                format!("training, by {}\n{}", trainer.shown(), numbers::table(&rows))
            }
            Standing::Stopped(stopped) => stopped_table(stopped, config),
        }
    }
}

/// Returns what keeps a run with this newest progress from going on, if anything does.
pub(crate) fn trouble(processes: &Processes, progress: Option<&Progress>) -> Option<String> {
    let silence =
        || format!("no progress: nothing heard from its learner for {} s", PATIENCE.as_secs());
    processes.trouble().or_else(|| match progress {
        None => Some(silence()),
        Some(progress) if progress.phase() == Phase::DiskFull => Some(doing(progress)),
        Some(_) => None,
    })
}

fn live_rows(progress: &Progress, config: &RunConfig) -> Vec<(&'static str, String)> {
    let mut rows = common_rows(config);
    rows.push(("doing", doing(progress)));
    if progress.steps_wanted > 0 {
        let steps = steps(progress.environment_steps(), progress.steps_wanted);
        rows.push(("environment steps", steps));
    }
    rows.extend(progress.update.iter().flat_map(update_rows));
    // A fixed reward has no versions. A model just read from a checkpoint has no losses yet.
    let learned = progress.reward_update.as_ref().filter(|update| update.model_version > 0);
    if let Some(update) = learned {
        if update.demonstration_loss.is_finite() {
            let losses = [update.demonstration_loss, update.agent_loss].map(numbers::number);
            let losses = format!("{} on demonstrations, {} on the agent", losses[0], losses[1]);
            rows.push(("reward loss", losses));
        }
        let steps = numbers::count(update.gradient_steps);
        rows.push(("reward model", format!("{steps} gradient steps in its last update")));
    }
    let (actors, leases) = (progress.actors, progress.leases);
    rows.push(("actors", format!("{actors}, {leases} leases handed out")));
    rows.push(("time", numbers::duration(progress.wall_s)));
    rows.push(("log since the last start", numbers::bytes(progress.log_bytes)));
    rows
}

/// Describes what a live run does.
pub(super) fn doing(progress: &Progress) -> String {
    match Phase::try_from(progress.phase) {
        Ok(Phase::Pretraining) => offline(progress),
        Ok(Phase::Training) | Err(_) if progress.steps_wanted == 0 => {
            "learning from the demonstrations".to_owned()
        }
        Ok(Phase::Training) | Err(_) => "rolling out and learning".to_owned(),
        Ok(Phase::Evaluating) => "evaluating the policy".to_owned(),
        Ok(Phase::Finished) => "ending".to_owned(),
        Ok(Phase::DiskFull) => "waiting for room on the disk".to_owned(),
    }
}

fn stopped_table(stopped: &Stopped, config: &RunConfig) -> String {
    let mut rows = common_rows(config);
    let place = match (&stopped.newest, &stopped.unreadable) {
        (Some((iteration, folder)), _) => place_of(*iteration, folder),
        (None, Some(error)) => format!("not known: {error}"),
        (None, None) => "none: the run starts over".to_owned(),
    };
    rows.push((NEWEST_CHECKPOINT, place));
    let use_of = |holder: &Holder| format!("{} by {}", holder.work.done_to_it(), holder.shown());
    rows.extend(stopped.holder.iter().map(|holder| ("being", use_of(holder))));
    rows.extend(stopped.damaged.iter().map(|error| ("damaged", error.to_string())));
    if let Some(update) = &stopped.update {
        let acting = config.learner.acts().then_some(config.steps);
        rows.extend(acting.map(|all| ("environment steps", steps(update.environment_steps, all))));
        rows.extend(update_rows(update));
        rows.extend(times_to_success(&stopped.times));
    }
    let heading = match &stopped.failure {
        Some(failure) => format!("failed: {failure}"),
        None if stopped.begun => "stopped, not finished".to_owned(),
        None => "never started".to_owned(),
    };
    format!("{heading}\n{}", numbers::table(&rows))
}

fn common_rows(config: &RunConfig) -> Vec<(&'static str, String)> {
    let RunConfig { task, method, preset, seed, .. } = config;
    vec![("run", format!("{task}, {method}, preset {preset}, seed {seed}"))]
}

/// Returns a row for the newest checkpoint, if there is one. Its files are not checked: they may be replaced meanwhile.
fn checkpoint_row(folder: &RunFolder) -> Option<(&'static str, String)> {
    let (iteration, folder) = folder.newest_checkpoint()?;
    Some((NEWEST_CHECKPOINT, place_of(iteration, &folder)))
}

fn place_of(iteration: u64, folder: &Path) -> String {
    format!("after iteration {}, {}", numbers::count(iteration), folder.display())
}

fn update_rows(update: &PolicyUpdate) -> Vec<(&'static str, String)> {
    let mut rows = vec![("iterations", numbers::count(update.iteration + 1))];
    if update.episodes > 0 {
        let success = numbers::percent(update.success_rate, 1);
        rows.push(("episodes", numbers::count(update.episodes)));
        rows.push(("success, last 100 training episodes", success));
    }
    let measured = [
        ("policy KL", update.approximate_kl),
        ("policy loss", update.policy_loss),
        ("held-out loss", update.held_out_loss),
        ("value loss", update.value_loss),
    ];
    let known = measured.into_iter().filter(|(_, number)| number.is_finite());
    rows.extend(known.map(|(name, number)| (name, numbers::number(number))));
    rows
}

fn steps(done: u64, wanted: u64) -> String {
    let percent = numbers::percent_done(done, wanted);
    format!("{} of {} ({percent} %)", numbers::count(done), numbers::count(wanted))
}

#[cfg(test)]
mod tests {
    use protocol::messages::{Pretraining, RewardUpdate};
    use run::folder::CHECKPOINT_FILES;
    use run::holder::Work;
    use run::tasks;

    use super::*;
    use crate::lock::Lock;
    use crate::progress_file;

    fn config() -> RunConfig {
        tasks::configuration("navigation", None, &[]).unwrap()
    }

    #[test]
    fn a_stopped_run_tells_its_checkpoint() {
        let directory = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(directory.path());
        let table = || stopped_table(&Stopped::of(&folder, None), &config());
        let found = table();
        assert!(found.starts_with("never started") && found.contains("starts over"), "{found}");
        std::fs::create_dir(folder.log()).unwrap();
        assert!(table().starts_with("stopped"));
        assert_eq!(checkpoint_row(&folder), None);
        let checkpoint = folder.checkpoint_folder(1250);
        std::fs::create_dir_all(&checkpoint).unwrap();
        let found = table();
        assert!(found.contains("starts over") && found.contains("damaged"), "{found}");
        for name in CHECKPOINT_FILES {
            protocol::tensors::Tensors::default().save(&checkpoint.join(name)).unwrap();
        }
        let found = table();
        assert!(found.contains("after iteration 1,250"), "{found}");
        assert_eq!(checkpoint_row(&folder), Some((NEWEST_CHECKPOINT, place_of(1250, &checkpoint))));
    }

    #[test]
    fn a_run_whose_bus_cannot_be_seen_is_told_by_its_files_unless_it_is_trained() {
        let directory = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(directory.path());
        std::fs::write(folder.config_file(), config().to_text()).unwrap();
        // A folder in place of the file, since root can read the file of another user.
        std::fs::create_dir(directory.path().join("bus")).unwrap();
        let table = || Status::of(folder.clone()).map(|status| status.table());
        assert!(table().unwrap().starts_with("never started"));
        let lock = Lock::take(&folder, Work::Training).unwrap();
        let said = table().unwrap_err().to_string();
        assert!(said.contains("who alone can reach the run's processes"), "{said}");
        drop(lock);
        let _lock = Lock::take(&folder, Work::Publishing).unwrap();
        let found = table().unwrap();
        let words = ["never started", "published by process"];
        assert!(words.iter().all(|words| found.contains(words)), "{found}");
    }

    #[test]
    fn a_failed_run_tells_why() {
        let directory = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(directory.path());
        std::fs::write(folder.config_file(), config().to_text()).unwrap();
        let mut lock = Lock::take(&folder, Work::Training).unwrap();
        lock.keep_failure("the disk is full".to_owned());
        drop(lock);
        let status = Status::of(folder.clone()).unwrap();
        let (table, figures) = (status.table(), status.figures());
        assert!(table.starts_with("failed: the disk is full\n"), "{table}");
        assert_eq!(figures["state"], "failed");
        assert_eq!(figures["failure"], "the disk is full");
        drop(Lock::take(&folder, Work::Training).unwrap());
        let table = Status::of(folder).unwrap().table();
        assert!(table.starts_with("never started"), "{table}");
    }

    #[test]
    fn a_run_that_another_machine_trains_is_told_by_its_folder() {
        let directory = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(directory.path());
        std::fs::write(folder.config_file(), config().to_text()).unwrap();
        std::fs::create_dir(folder.output()).unwrap();
        let held = std::fs::File::create(folder.lock_file()).unwrap();
        held.lock().unwrap();
        let trainer = r#"{"work":"training","process":12,"machine":"node-7"}"#;
        std::fs::write(folder.lock_file(), trainer).unwrap();
        progress_file::write(&folder, &Progress { actors: 3, ..Progress::default() }).unwrap();
        std::fs::create_dir_all(folder.checkpoint_folder(8)).unwrap();
        let status = Status::of(folder).unwrap();
        assert_eq!(status.figures()["checkpoint"]["iteration"], 8);
        let found = status.table();
        assert!(found.starts_with("training, by process 12 on node-7"), "{found}");
        assert!(found.contains("after iteration 8, "), "{found}");
        assert!(found.contains("3, 0 leases") && found.contains("ago"), "{found}");
    }

    #[test]
    fn a_live_run_does_what_its_method_does() {
        let training = Progress { phase: Phase::Training as i32, ..Progress::default() };
        assert_eq!(doing(&training), "learning from the demonstrations");
        assert_eq!(doing(&Progress { steps_wanted: 8, ..training }), "rolling out and learning");
    }

    #[test]
    fn a_live_run_without_an_update_has_a_table() {
        let begun = Progress { steps_wanted: 8, ..Progress::default() };
        let table = numbers::table(&live_rows(&begun, &config()));
        assert!(table.contains("waiting for the proximity service"), "{table}");
        assert!(table.contains("0 of 8 (0 %)"), "{table}");
        assert!(table.contains("navigation, goal-proximity, preset goalward"), "{table}");
        let pretraining = Some(Pretraining { done: 30, total: 120 });
        let reward_update =
            Some(RewardUpdate { model_version: 2, gradient_steps: 64, ..RewardUpdate::default() });
        let progress = Progress { pretraining, reward_update, ..Progress::default() };
        let table = numbers::table(&live_rows(&progress, &config()));
        assert!(table.contains("30 of 120 gradient steps (25 %)"), "{table}");
        assert!(table.contains("64 gradient steps in its last update"), "{table}");
    }
}
