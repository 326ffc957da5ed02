//! `goalward status`: how a run stands. A live run says so itself, on the bus; of any other run the
//! folder tells.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use prost::Message;
use protocol::bus::{Bus, BusAddress, Role, SharedMemory};
use protocol::config::RunConfig;
use protocol::log::{Contents, Record, read_contents};
use protocol::messages::{Phase, PolicyUpdate, Progress};
use protocol::run::RunFolder;
use protocol::summary::Summary;

use crate::figures;
use crate::progress::print_line;
use crate::summary;

/// How long a live run is listened to; it publishes several times a second.
const PATIENCE: Duration = Duration::from_secs(1);

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
    let address = BusAddress::of_run(folder.path())?;
    let table = if address.is_anyone_alive()? {
        live(&address, &config)?
    } else if let Some(summary) = Summary::of_run(&folder)? {
        format!("finished\n{}", summary::table(&summary))
    } else {
        stopped(&folder, &config)
    };
    print_line(table.trim_end());
    Ok(())
}

fn live(address: &BusAddress, config: &RunConfig) -> Result<String> {
    let bus = Bus::<SharedMemory>::open(address, "status")?;
    let doorbell = bus.doorbell(Role::Supervisor)?;
    let subscriber = bus.progress_subscriber()?;
    let start = Instant::now();
    loop {
        if let Some(bytes) = subscriber.receive()? {
            let progress = Progress::decode(bytes).context("reading the progress of the run")?;
            return Ok(format!("training\n{}", figures::table(&live_rows(&progress, config))));
        }
        let left = PATIENCE.saturating_sub(start.elapsed());
        if left.is_zero() {
            let rows = common_rows(config);
            return Ok(format!("starting, no figures yet\n{}", figures::table(&rows)));
        }
        doorbell.wait(left)?;
    }
}

fn live_rows(progress: &Progress, config: &RunConfig) -> Vec<(&'static str, String)> {
    let doing = match Phase::try_from(progress.phase) {
        Ok(Phase::Pretraining) => "training the reward model offline",
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
    if let Some(update) = &progress.reward_update {
        let losses = [update.demonstration_loss, update.agent_loss].map(figures::number);
        let losses = format!("{} on demonstrations, {} on the agent", losses[0], losses[1]);
        rows.push(("reward loss", losses));
    }
    let (actors, leases) = (progress.actors, progress.leases);
    rows.push(("actors", format!("{actors}, {leases} leases handed out")));
    rows.push(("time", figures::duration(progress.wall_s)));
    rows.push(("log", figures::bytes(progress.log_bytes)));
    rows
}

fn stopped(folder: &RunFolder, config: &RunConfig) -> String {
    let mut rows = common_rows(config);
    let newest = folder.newest_checkpoint();
    let place = newest.as_ref().map_or_else(
        || "none: it begins anew".to_owned(),
        |(iteration, path)| {
            format!("after iteration {}, {}", figures::count(*iteration), path.display())
        },
    );
    rows.push(("newest checkpoint", place));
    if let Some((iteration, _)) = newest
        && let Some(update) = last_update_before(folder, iteration)
    {
        rows.push(("environment steps", steps(update.environment_steps, config.steps)));
        rows.extend(update_rows(&update));
    }
    format!("stopped, not finished\n{}", figures::table(&rows))
}

/// The newest update that the checkpoint after `iteration` iterations contains.
///
/// The log is only looked at for figures: one that cannot be read costs them, nothing else.
fn last_update_before(folder: &RunFolder, iteration: u64) -> Option<PolicyUpdate> {
    let records = read_contents(&folder.log(), Contents::Updates).ok()?;
    let updates = records.flatten().filter_map(|entry| match entry.record {
        Record::PolicyUpdate(update) => Some(*update),
        _ => None,
    });
    updates.filter(|update| update.iteration < iteration).last()
}

fn common_rows(config: &RunConfig) -> Vec<(&'static str, String)> {
    vec![("run", format!("{}, preset {}, seed {}", config.task, config.preset, config.seed))]
}

fn update_rows(update: &PolicyUpdate) -> Vec<(&'static str, String)> {
    vec![
        ("iterations", figures::count(update.iteration + 1)),
        ("episodes", figures::count(update.episodes)),
        ("success, last 100 training episodes", figures::percent(update.success_rate, 1)),
        ("policy KL, value loss", {
            let (divergence, value) = (update.approximate_kl, update.value_loss);
            format!("{}, {}", figures::number(divergence), figures::number(value))
        }),
    ]
}

fn steps(done: u64, wanted: u64) -> String {
    let percent = figures::percent_done(done, wanted);
    format!("{} of {} ({percent} %)", figures::count(done), figures::count(wanted))
}

#[cfg(test)]
mod tests {
    use protocol::task::Task;

    use super::*;
    use crate::tasks;

    fn config() -> RunConfig {
        tasks::configuration(Task::Navigation, "goalward", &[]).unwrap()
    }

    #[test]
    fn a_stopped_run_tells_its_checkpoint() {
        let directory = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(directory.path());
        assert!(stopped(&folder, &config()).contains("begins anew"));
        std::fs::create_dir_all(folder.checkpoint_folder(1250)).unwrap();
        let table = stopped(&folder, &config());
        assert!(table.contains("after iteration 1,250"), "{table}");
    }

    #[test]
    fn a_live_run_without_an_update_has_a_table() {
        let table = figures::table(&live_rows(&Progress::default(), &config()));
        assert!(table.contains("offline"), "{table}");
        assert!(table.contains("0 of 0 (0 %)"), "{table}");
    }
}
