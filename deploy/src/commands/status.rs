//! `goalward status`: how a run stands. A live run says so itself, on the bus; of any other run the
//! folder tells.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::Result;
use bus::{Bus, BusAddress, Role, SharedMemory};
use prost::Message;
use protocol::messages::{Phase, PolicyUpdate, Progress};
use run::checkpoint;
use run::config::RunConfig;
use run::demonstrations::file_of;
use run::folder::{CHECKPOINT_FILES, RunFolder};
use run::summary::Summary;
use run::time_to_success::TimeToSuccess;
use run::updates::policy_updates;

use crate::processes::Processes;
use crate::progress::offline;
use crate::summary;
use terminal::numbers;
use terminal::print::{print_line, print_remark};

/// How long a live run is listened to; it publishes every second at least.
const PATIENCE: Duration = Duration::from_secs(3);

/// Flags of `goalward status`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Folder of the run.
    run: PathBuf,
}

/// Prints a table.
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let folder = RunFolder::new(&arguments.run);
    let config = folder.config()?;
    let address = BusAddress::if_started(folder.path())?;
    let processes = address.as_ref().map(Processes::on).transpose()?;
    let training = processes.filter(Processes::train);
    let table = if let (Some(address), Some(processes)) = (address, training) {
        live(&folder, &address, &config, &processes)?
    } else if let Some(summary) = Summary::of_finished(&folder, print_remark) {
        format!("finished\n{}", summary::table(&summary))
    } else if folder.is_trained() {
        beginning(&folder, &config)
    } else {
        stopped(&folder, &config)
    };
    print_line(table.trim_end());
    Ok(())
}

fn live(
    folder: &RunFolder,
    address: &BusAddress,
    config: &RunConfig,
    processes: &Processes,
) -> Result<String> {
    let progress = listen(address)?;
    let silence =
        || format!("no progress: its learner has said nothing for {} s", PATIENCE.as_secs());
    let (headline, mut rows, heard) = match progress {
        Some(progress) => {
            ("training".to_owned(), live_rows(&progress, config), progress.actors_heard)
        }
        None => (silence(), common_rows(config), Vec::new()),
    };
    rows.extend(times_to_success(folder));
    let headline = processes.trouble().unwrap_or(headline);
    Ok(format!("{headline}\n{}{}", numbers::table(&rows), processes.table(&heard)))
}

/// The newest progress of a run; none while its learner says nothing.
fn listen(address: &BusAddress) -> Result<Option<Progress>> {
    let bus = Bus::<SharedMemory>::open(address, "status")?;
    let doorbell = bus.doorbell(Role::Supervisor)?;
    let subscriber = bus.progress_subscriber()?;
    let start = Instant::now();
    loop {
        // What is no progress is not the learner's.
        if let Some(Ok(progress)) = subscriber.receive()?.map(Progress::decode) {
            return Ok(Some(progress));
        }
        let left = PATIENCE.saturating_sub(start.elapsed());
        if left.is_zero() {
            return Ok(None);
        }
        doorbell.wait(left)?;
    }
}

/// Somebody has the run, but none of its processes is on the bus.
fn beginning(folder: &RunFolder, config: &RunConfig) -> String {
    let records = config.imitates() && !file_of(folder, config).exists();
    let doing =
        if records { "recording its demonstrations" } else { "its processes are not there yet" };
    format!("starting: {doing}\n{}", numbers::table(&common_rows(config)))
}

fn live_rows(progress: &Progress, config: &RunConfig) -> Vec<(&'static str, String)> {
    let offline = offline(progress);
    let doing = match Phase::try_from(progress.phase) {
        Ok(Phase::Pretraining) => offline.as_str(),
        Ok(Phase::Training) | Err(_) => "rolling out and learning",
        Ok(Phase::Evaluating) => "evaluating the policy",
        Ok(Phase::Finished) => "ending",
        Ok(Phase::DiskFull) => "waiting for room on the disk",
    };
    let mut rows = common_rows(config);
    rows.push(("doing", doing.to_owned()));
    let done = progress.update.as_ref().map_or(0, |update| update.environment_steps);
    rows.push(("environment steps", steps(done, progress.steps_wanted)));
    rows.extend(progress.update.iter().flat_map(update_rows));
    // A fixed reward has no versions, and one just read from a checkpoint has no losses yet.
    let learned = progress.reward_update.as_ref().filter(|update| update.model_version > 0);
    if let Some(update) = learned {
        let losses = [update.demonstration_loss, update.agent_loss].map(numbers::number);
        let losses = format!("{} on demonstrations, {} on the agent", losses[0], losses[1]);
        rows.push(("reward loss", losses));
        let steps = numbers::count(update.gradient_steps);
        rows.push(("reward model", format!("{steps} gradient steps in its last update")));
    }
    let (actors, leases) = (progress.actors, progress.leases);
    rows.push(("actors", format!("{actors}, {leases} leases handed out")));
    rows.push(("time", numbers::duration(progress.wall_s)));
    rows.push(("log", numbers::bytes(progress.log_bytes)));
    rows
}

fn stopped(folder: &RunFolder, config: &RunConfig) -> String {
    let mut rows = common_rows(config);
    let found = checkpoint::newest(folder, &CHECKPOINT_FILES).unwrap_or_default();
    let place = found.newest.as_ref().map_or_else(
        || "none: it begins anew".to_owned(),
        |newest| {
            let iteration = numbers::count(newest.iteration);
            format!("after iteration {iteration}, {}", newest.folder.display())
        },
    );
    rows.push(("newest checkpoint", place));
    rows.extend(found.damaged.iter().map(|(_, error)| ("damaged", error.to_string())));
    if let Some(newest) = found.newest
        && let Some(update) = last_update_before(folder, newest.iteration)
    {
        rows.push(("environment steps", steps(update.environment_steps, config.steps)));
        rows.extend(update_rows(&update));
        rows.extend(times_to_success(folder));
    }
    let heading = if folder.log().exists() { "stopped, not finished" } else { "never started" };
    format!("{heading}\n{}", numbers::table(&rows))
}

/// What the log has of them: one that cannot be read costs them, nothing else.
fn times_to_success(folder: &RunFolder) -> Vec<(&'static str, String)> {
    summary::times_to_success(&TimeToSuccess::of_run(folder).unwrap_or_default()).collect()
}

/// The newest update that the checkpoint after `iteration` iterations contains.
///
/// The log is only looked at for metrics: one that cannot be read costs them, nothing else.
fn last_update_before(folder: &RunFolder, iteration: u64) -> Option<PolicyUpdate> {
    let updates = policy_updates(folder).ok()?.flatten();
    updates.filter(|update| update.iteration < iteration).last()
}

fn common_rows(config: &RunConfig) -> Vec<(&'static str, String)> {
    vec![("run", format!("{}, preset {}, seed {}", config.task, config.preset, config.seed))]
}

fn update_rows(update: &PolicyUpdate) -> Vec<(&'static str, String)> {
    vec![
        ("iterations", numbers::count(update.iteration + 1)),
        ("episodes", numbers::count(update.episodes)),
        ("success, last 100 training episodes", numbers::percent(update.success_rate, 1)),
        ("policy KL, value loss", {
            let (divergence, value) = (update.approximate_kl, update.value_loss);
            format!("{}, {}", numbers::number(divergence), numbers::number(value))
        }),
    ]
}

fn steps(done: u64, wanted: u64) -> String {
    let percent = numbers::percent_done(done, wanted);
    format!("{} of {} ({percent} %)", numbers::count(done), numbers::count(wanted))
}

#[cfg(test)]
mod tests {
    use protocol::messages::{Pretraining, RewardUpdate};

    use super::*;
    use run::tasks;

    fn config() -> RunConfig {
        tasks::configuration("navigation", "goalward", &[]).unwrap()
    }

    #[test]
    fn a_stopped_run_tells_its_checkpoint() {
        let directory = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(directory.path());
        let table = stopped(&folder, &config());
        assert!(table.starts_with("never started") && table.contains("begins anew"), "{table}");
        std::fs::create_dir(folder.log()).unwrap();
        assert!(stopped(&folder, &config()).starts_with("stopped"));
        let checkpoint = folder.checkpoint_folder(1250);
        std::fs::create_dir_all(&checkpoint).unwrap();
        let table = stopped(&folder, &config());
        assert!(table.contains("begins anew") && table.contains("damaged"), "{table}");
        for name in CHECKPOINT_FILES {
            protocol::tensors::Tensors::default().save(&checkpoint.join(name)).unwrap();
        }
        let table = stopped(&folder, &config());
        assert!(table.contains("after iteration 1,250"), "{table}");
    }

    #[test]
    fn a_live_run_without_an_update_has_a_table() {
        let table = numbers::table(&live_rows(&Progress::default(), &config()));
        assert!(table.contains("offline"), "{table}");
        assert!(table.contains("0 of 0 (0 %)"), "{table}");
        let pretraining = Some(Pretraining { done: 30, total: 120 });
        let reward_update =
            Some(RewardUpdate { model_version: 2, gradient_steps: 64, ..RewardUpdate::default() });
        let progress = Progress { pretraining, reward_update, ..Progress::default() };
        let table = numbers::table(&live_rows(&progress, &config()));
        assert!(table.contains("30 of 120 gradient steps (25 %)"), "{table}");
        assert!(table.contains("64 gradient steps in its last update"), "{table}");
    }
}
