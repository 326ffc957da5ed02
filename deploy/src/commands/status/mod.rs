//! `goalward status`: how a run stands. A live run says so itself, on the bus; of any other run the
//! folder tells.

mod figures;
mod table;

use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::Result;
use bus::{Bus, BusAddress, Role};
use prost::Message;
use protocol::Error;
use protocol::messages::{PolicyUpdate, Progress};
use run::checkpoint;
use run::config::RunConfig;
use run::demonstrations::file_of;
use run::folder::{CHECKPOINT_FILES, RunFolder};
use run::hosts::Hosts;
use run::summary::Summary;
use run::time_to_success::TimeToSuccess;
use run::updates::policy_updates;

use crate::figures::Figures;
use crate::processes::Processes;
use terminal::print::print_remark;

pub(crate) use table::trouble;

/// How long a live run is listened to; it publishes every second at least.
pub(crate) const PATIENCE: Duration = Duration::from_secs(3);

/// Flags of `goalward status`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Folder of the run.
    run: PathBuf,
    #[command(flatten)]
    figures: Figures,
}

/// Prints how a run stands.
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let status = Status::of(RunFolder::new(&arguments.run))?;
    arguments.figures.print(&status.figures(), |_| status.table())
}

/// A run, and how it stands.
struct Status {
    folder: RunFolder,
    config: RunConfig,
    standing: Standing,
}

enum Standing {
    /// Its processes are on the bus; the progress is none while its learner says nothing.
    Live {
        processes: Processes,
        progress: Option<Box<Progress>>,
        times: Vec<TimeToSuccess>,
        hosts: Hosts,
    },
    Finished(Box<Summary>),
    /// Somebody has it, but none of its processes is on the bus.
    Beginning {
        records: bool,
    },
    Stopped(Box<Stopped>),
}

/// Where a run that is not finished goes on.
#[derive(Default)]
struct Stopped {
    /// Whether it was ever trained.
    begun: bool,
    /// Iterations and folder of the newest checkpoint.
    newest: Option<(u64, PathBuf)>,
    damaged: Vec<Error>,
    /// The newest update that the checkpoint contains.
    update: Option<PolicyUpdate>,
    times: Vec<TimeToSuccess>,
}

impl Status {
    fn of(folder: RunFolder) -> Result<Status> {
        let config = folder.config()?;
        let training = match in_training(&folder) {
            // A bus is open to its user alone; that nobody trains the run everybody can see.
            Err(_) if !folder.is_trained() => None,
            found => found?,
        };
        let standing = if let Some((address, processes)) = training {
            let progress = listen(&address)?.map(Box::new);
            let (times, hosts) = (times_to_success(&folder), Hosts::of_run(&folder));
            Standing::Live { processes, progress, times, hosts }
        } else if let Some(summary) = Summary::of_finished(&folder, print_remark) {
            Standing::Finished(Box::new(summary))
        } else if folder.is_trained() {
            let records = config.imitates() && !file_of(&folder, &config).exists();
            Standing::Beginning { records }
        } else {
            Standing::Stopped(Box::new(Stopped::of(&folder)))
        };
        Ok(Status { folder, config, standing })
    }
}

impl Stopped {
    fn of(folder: &RunFolder) -> Stopped {
        let found = checkpoint::newest(folder, &CHECKPOINT_FILES).unwrap_or_default();
        let newest = found.newest.map(|newest| (newest.iteration, newest.folder));
        Stopped {
            begun: folder.log().exists(),
            damaged: found.damaged.into_iter().map(|(_, error)| error).collect(),
            update: newest.as_ref().and_then(|(number, _)| last_update_before(folder, *number)),
            newest,
            times: times_to_success(folder),
        }
    }
}

/// The bus of a run and its processes; none where no training is on it.
fn in_training(folder: &RunFolder) -> Result<Option<(BusAddress, Processes)>> {
    let Some(address) = BusAddress::if_started(folder.path())? else { return Ok(None) };
    let processes = Processes::on(&address)?;
    Ok(processes.train().then_some((address, processes)))
}

/// The newest progress of a run; none while its learner says nothing.
fn listen(address: &BusAddress) -> Result<Option<Progress>> {
    let bus = Bus::open(address, "status")?;
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

/// What the log has of them: one that cannot be read costs them, nothing else.
fn times_to_success(folder: &RunFolder) -> Vec<TimeToSuccess> {
    TimeToSuccess::of_run(folder).unwrap_or_default()
}

/// The newest update that the checkpoint after `iteration` iterations contains.
///
/// The log is only looked at for metrics: one that cannot be read costs them, nothing else.
fn last_update_before(folder: &RunFolder, iteration: u64) -> Option<PolicyUpdate> {
    let updates = policy_updates(folder).ok()?.flatten();
    updates.filter(|update| update.iteration < iteration).last()
}
