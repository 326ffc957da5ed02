//! `goalward join`: actors on this machine for a run on another machine.

use std::ffi::OsString;
use std::fs::{self, DirEntry};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, Result};
use bus::{BusAddress, check_shared_memory_room};
use protocol::MAX_ACTORS;
use run::folder::RunFolder;
use run::holder::Work;
use terminal::print::print_remark;
use terminal::refusal::{stopped, wrong_usage};

use crate::limits;
use crate::listening::{golden, host_name};
use crate::lock::Lock;
use crate::machine::Machine;
use crate::programs::{self, Program};
use crate::progress::ProgressView;
use crate::supervisor::{Joining, Outcome, Source, runtime, take_part};

/// Most actors that a machine brings by default, since the run and other machines need places, too.
const MOST_UNASKED: u64 = MAX_ACTORS as u64 / 2;

/// Prefix of the name of the temporary folder of a `goalward join`.
const FOLDER: &str = "goalward-join-";

/// A folder that is younger may not have been locked yet by the process that made it.
const YOUNG: Duration = Duration::from_secs(10);

/// Flags of `goalward join`.
#[derive(Debug, clap::Args)]
#[command(group = clap::ArgGroup::new("run_or_key").required(true).args(["key", "run"]))]
pub(crate) struct Arguments {
    /// Address at which the run listens; by default the one in its key.
    #[arg(value_name = "HOST:PORT", value_parser = host_and_port)]
    address: Option<String>,
    /// The run's file join.toml, or a copy of it.
    #[arg(long, value_name = "FILE")]
    key: Option<PathBuf>,
    /// Folder of the run, if both machines share it.
    #[arg(long, value_name = "DIR")]
    run: Option<PathBuf>,
    /// Actor processes on this machine; by default one for each core, but at most 32: a run has 64 in all.
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..=MAX_ACTORS as u64))]
    actors: Option<u64>,
    /// What this machine is called; by default its host name.
    #[arg(long)]
    name: Option<String>,
    /// Joins although this build differs from the run's, if its actor produces the same episodes.
    #[arg(long)]
    other_build: bool,
}

/// Accepts an address with a port; whether the host exists shows when it is connected to.
fn host_and_port(text: &str) -> Result<String, String> {
    let parts = text.rsplit_once(':').filter(|(host, port)| {
        let is_whole = !host.contains(':') || (host.starts_with('[') && host.ends_with(']'));
        !host.is_empty() && is_whole && port.parse::<u16>().is_ok_and(|port| port > 0)
    });
    match parts {
        Some(_) => Ok(text.to_owned()),
        None => Err(format!("expected HOST:PORT, found {text}")),
    }
}

impl Arguments {
    fn key(&self) -> Result<PathBuf> {
        let of_run = || self.run.as_ref().map(|run| RunFolder::new(run).join_file());
        let key = self.key.clone().or_else(of_run).context("a key or a run is required")?;
        let shown = key.display();
        if !key.is_file() {
            return Err(wrong_usage(format!(
                "expected the key of a run, which `train --listen` writes, found no {shown}"
            )));
        }
        key.canonicalize().with_context(|| shown.to_string())
    }

    fn actors(&self) -> u64 {
        let cores = || std::thread::available_parallelism().map_or(1, |cores| cores.get() as u64);
        self.actors.unwrap_or_else(|| cores().min(MOST_UNASKED))
    }
}

/// Takes part in a run until it is over.
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    Program::Gateway.check()?;
    let (key, count) = (arguments.key()?, arguments.actors());
    Machine::here().require_room_for_actors("--actors", count)?;
    check_shared_memory_room(limits::SHARED_MEMORY_BYTES)?;
    let temporary = std::env::temp_dir();
    sweep(&temporary);
    let place = tempfile::Builder::new().prefix(FOLDER).tempdir_in(&temporary)?;
    let folder = RunFolder::new(place.path());
    let _lock = Lock::take(&folder, Work::Joining)?;
    if !lay_out(&folder, &key, arguments.address.as_deref())? {
        return Err(stopped());
    }
    let config = folder.config()?;
    let golden = golden(&folder, &config.task)?;
    let host = arguments.name.clone().unwrap_or_else(host_name);
    let task = &config.task.name;
    let is_cut = arguments.actors.is_none() && count == MOST_UNASKED;
    let more = if is_cut { " (more by --actors)" } else { "" };
    print_remark(&format!("joining a run of {task}, actors: {count}{more}; Ctrl-C leaves it"));
    let mut gateway = vec!["join".into(), "--run".into(), folder.path().into()];
    gateway.extend(key_arguments(&key, arguments.address.as_deref()));
    gateway.extend(["--host".into(), host.into(), "--golden".into(), golden.into()]);
    gateway.extend(["--actors".into(), count.to_string().into()]);
    gateway.extend(arguments.other_build.then(|| "--other-build".into()));
    let program = Program::acting_in(&config.task);
    let source = Source::Environments { count, program, listening: None };
    let view = ProgressView::new();
    let joining = Joining { folder, gateway, source };
    let outcome = runtime()?.block_on(take_part(&joining, &view));
    if outcome.is_err() {
        // The error names files in it. The next `join` sweeps it.
        tracing::debug!("{} is kept", place.keep().display());
    }
    match outcome? {
        Outcome::Stopped => Err(stopped()),
        Outcome::Finished | Outcome::EndOfLog => {
            print_remark("the training has ended");
            Ok(())
        }
    }
}

/// Removes what `goalward join` processes of this user left when they were killed.
fn sweep(temporary: &Path) {
    let entries = fs::read_dir(temporary).into_iter().flatten().flatten();
    let is_one =
        |entry: &DirEntry| entry.file_name().as_encoded_bytes().starts_with(FOLDER.as_bytes());
    for path in entries.filter(is_one).map(|entry| entry.path()) {
        if let Err(error) = remove_if_left(&path) {
            tracing::debug!("{} could not be removed: {error:#}", path.display());
        }
    }
}

/// Removes the folder of a `goalward join`, and what it has in shared memory, unless another process holds its lock.
///
/// # Errors
/// When one of its processes still lives, or the system refuses.
fn remove_if_left(path: &Path) -> Result<()> {
    let found = fs::symlink_metadata(path)?;
    let is_ours = found.is_dir() && found.uid() == rustix::process::geteuid().as_raw();
    if !is_ours || found.modified()?.elapsed().unwrap_or_default() < YOUNG {
        return Ok(());
    }
    let Ok(lock) = Lock::take(&RunFolder::new(path), Work::CleaningUp) else { return Ok(()) };
    if let Some(bus) = BusAddress::if_started(path)? {
        bus.remove()?;
    }
    // A folder on NFS cannot be removed while a file in it is open.
    drop(lock);
    Ok(fs::remove_dir_all(path)?)
}

/// Lays out the folder that actors work in; returns false if the user stops it.
fn lay_out(folder: &RunFolder, key: &Path, address: Option<&str>) -> Result<bool> {
    fs::create_dir(folder.output())?;
    let mut gateway = Program::Gateway.command()?;
    gateway.arg("lay-out").arg("--run").arg(folder.path()).args(key_arguments(key, address));
    let ended = programs::run_unless_stopped(&mut gateway, "reaching the run")?;
    let ended = ended.map(|ended| programs::expect_success(ended.status)).transpose();
    ended.map(|ended| ended.is_some())
}

fn key_arguments(key: &Path, address: Option<&str>) -> Vec<OsString> {
    let mut arguments = vec!["--key".into(), key.into()];
    if let Some(address) = address {
        arguments.extend(["--address".into(), address.into()]);
    }
    arguments
}

#[cfg(test)]
mod tests {
    use std::time::SystemTime;

    use super::*;

    #[test]
    fn an_address_has_a_port() {
        for address in ["hub:7447", "127.0.0.1:7447", "[::1]:7447"] {
            assert_eq!(host_and_port(address), Ok(address.to_owned()));
        }
        for address in ["127.0.0.1", "hub:", ":7447", "hub:0", "hub:70000", "::1"] {
            let said = host_and_port(address).unwrap_err();
            assert_eq!(said, format!("expected HOST:PORT, found {address}"));
        }
    }

    #[test]
    fn what_killed_joinings_left_is_swept() {
        let directory = tempfile::tempdir().unwrap();
        let made = |name: &str| {
            let path = directory.path().join(name);
            fs::create_dir(&path).unwrap();
            path
        };
        let names = ["goalward-join-left", "goalward-join-held", "another", "goalward-join-young"];
        let [left, held, another, young] = names.map(made);
        let bus = BusAddress::for_start(&left).unwrap();
        let shared = PathBuf::from(format!("/dev/shm/{}left", bus.prefix()));
        fs::write(&shared, "").unwrap();
        let _lock = Lock::take(&RunFolder::new(&held), Work::Joining).unwrap();
        for old in [&left, &held, &another] {
            fs::File::open(old).unwrap().set_modified(SystemTime::UNIX_EPOCH).unwrap();
        }
        sweep(directory.path());
        assert!(!left.exists() && !shared.exists());
        assert!(held.exists() && another.exists() && young.exists());
    }
}
