//! `goalward status`: the state of a run. A live run reports it on the bus; that of any other run is read from its
//! folder.

mod figures;
mod table;

use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::Result;
use bus::{Bus, BusAddress, Role};
use prost::Message;
use protocol::Error;
use protocol::messages::{PolicyUpdate, Progress};
use run::checkpoint::{self, NewestCheckpoint};
use run::config::RunConfig;
use run::demonstrations::file_of;
use run::folder::{CHECKPOINT_FILES, RunFolder};
use run::holder::{Holder, Work};
use run::hosts::Hosts;
use run::overview;
use run::summary::Summary;
use run::time_to_success::TimeToSuccess;
use run::updates::{measured, policy_updates};

use crate::listening::node_name;
use crate::output_format::OutputFormat;
use crate::processes::Processes;
use crate::progress_file;
use terminal::print::print_remark;

pub(crate) use table::trouble;

/// How long to listen to a live run, which publishes at least once a second.
pub(crate) const PATIENCE: Duration = Duration::from_secs(3);

/// Flags of `goalward status`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Folder of the run.
    run: PathBuf,
    #[command(flatten)]
    output: OutputFormat,
}

/// Prints the state of a run.
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let status = Status::of(RunFolder::new(&arguments.run))?;
    arguments.output.print(&status.figures(), |_| status.table())
}

/// A run and its state.
struct Status {
    folder: RunFolder,
    config: RunConfig,
    standing: Standing,
}

enum Standing {
    /// Processes of the run are on the bus; `progress` is `None` while the learner says nothing.
    Live {
        processes: Processes,
        progress: Option<Box<Progress>>,
        times: Vec<TimeToSuccess>,
        hosts: Hosts,
    },
    Finished(Box<Summary>),
    /// A process of this machine trains the run, but none of its processes is on the bus yet.
    Beginning {
        records: bool,
    },
    /// A process of another machine trains the run, as the folder tells.
    Elsewhere {
        trainer: Holder,
        progress: Option<Box<Progress>>,
        age: Duration,
        times: Vec<TimeToSuccess>,
    },
    Stopped(Box<Stopped>),
}

/// Returns the state of a run that is being trained, but not by processes on a bus that is seen from here.
fn begun(folder: &RunFolder, config: &RunConfig, trainer: Holder) -> Standing {
    if trainer.process.is_none() || trainer.machine == node_name() {
        let records = config.imitates() && !file_of(folder, config).exists();
        return Standing::Beginning { records };
    }
    let progress = progress_file::read(folder).map(|progress| Box::new(measured(config, progress)));
    let (age, times) = (progress_file::age(folder), times_to_success(folder));
    Standing::Elsewhere { trainer, progress, age, times }
}

/// Where an unfinished run would continue.
#[derive(Default)]
struct Stopped {
    /// What else a process does with the run now.
    holder: Option<Holder>,
    /// Why its last training ended, if it failed.
    failure: Option<String>,
    /// Whether the run was ever trained.
    begun: bool,
    /// Iterations and folder of the newest checkpoint.
    newest: Option<(u64, PathBuf)>,
    damaged: Vec<Error>,
    /// Why the checkpoints cannot be read, if that is so.
    unreadable: Option<Error>,
    /// The newest update that the checkpoint contains.
    update: Option<PolicyUpdate>,
    times: Vec<TimeToSuccess>,
}

impl Status {
    fn of(folder: RunFolder) -> Result<Status> {
        let config = folder.config()?;
        let training = match in_training(&folder) {
            // A bus is open only to its user, but everybody can see that nobody trains the run.
            Err(_) if !folder.is_trained() => None,
            found => found?,
        };
        let standing = if let Some((address, processes)) = training {
            let progress = listen(&address)?;
            let progress = progress.map(|progress| Box::new(measured(&config, progress)));
            let (times, hosts) = (times_to_success(&folder), Hosts::of_run(&folder));
            Standing::Live { processes, progress, times, hosts }
        } else if let Some(summary) = Summary::of_finished(&folder, print_remark) {
            Standing::Finished(Box::new(summary))
        } else {
            match folder.holder() {
                Some(trainer) if trainer.work == Work::Training => begun(&folder, &config, trainer),
                holder => Standing::Stopped(Box::new(Stopped::of(&folder, holder))),
            }
        };
        Ok(Status { folder, config, standing })
    }
}

impl Stopped {
    fn of(folder: &RunFolder, holder: Option<Holder>) -> Stopped {
        let (found, unreadable) = match checkpoint::newest(folder, &CHECKPOINT_FILES) {
            Ok(found) => (found, None),
            Err(error) => (NewestCheckpoint::default(), Some(error)),
        };
        let newest = found.newest.map(|newest| (newest.iteration, newest.folder));
        Stopped {
            holder,
            failure: overview::failure(folder),
            unreadable,
            begun: folder.log().exists(),
            damaged: found.damaged.into_iter().map(|(_, error)| error).collect(),
            update: newest.as_ref().and_then(|(number, _)| last_update_before(folder, *number)),
            newest,
            times: times_to_success(folder),
        }
    }
}

/// Returns the bus of a run and its processes; `None` if no training is on it.
fn in_training(folder: &RunFolder) -> Result<Option<(BusAddress, Processes)>> {
    let Some(address) = BusAddress::if_started(folder.path())? else { return Ok(None) };
    let processes = Processes::on(&address)?;
    Ok(processes.train().then_some((address, processes)))
}

/// Waits for the newest progress of a run; `None` if its learner says nothing.
fn listen(address: &BusAddress) -> Result<Option<Progress>> {
    let bus = Bus::open(address, "status")?;
    let doorbell = bus.doorbell(Role::Supervisor)?;
    let subscriber = bus.progress_subscriber()?;
    let start = Instant::now();
    loop {
        // A message that is not progress does not come from the learner.
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

/// Returns the times to success from the log; none if it cannot be read.
fn times_to_success(folder: &RunFolder) -> Vec<TimeToSuccess> {
    TimeToSuccess::of_run(folder).unwrap_or_default()
}

/// Returns the newest update that the checkpoint after `iteration` iterations contains.
///
/// The log is needed only for metrics: if it cannot be read, they are missing.
fn last_update_before(folder: &RunFolder, iteration: u64) -> Option<PolicyUpdate> {
    let updates = policy_updates(folder).ok()?.flatten();
    updates.filter(|update| update.iteration < iteration).last()
}
