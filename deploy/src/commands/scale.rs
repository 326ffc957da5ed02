//! `goalward scale`: changes the number of actors of a run that is being trained.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Result, bail, ensure};
use bus::BusAddress;
use protocol::MAX_ACTORS;
use run::actors_wanted::ActorsWanted;
use run::folder::RunFolder;
use run::hosts::{Host, Hosts};

use crate::listening::{node_name, require_an_actor};
use crate::lock;
use crate::machine::Machine;
use crate::processes::Processes;
use terminal::print::{print_line, print_remark};
use terminal::refusal::wrong_usage;

/// How long another machine may take to have the wanted number of actors.
const PATIENCE: Duration = Duration::from_secs(10);

/// How long the supervisor may take to refuse a number of actors; it looks many times in between.
const ANSWER: Duration = Duration::from_secs(2);

/// Time between two looks at the machine.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// Flags of `goalward scale`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Folder of the run.
    run: PathBuf,
    /// New number of actor processes; 0 on the learner's machine requires a run that other machines can join.
    #[arg(long, value_parser = clap::value_parser!(u64).range(..=MAX_ACTORS as u64))]
    actors: u64,
    /// Machine that runs them, as `goalward status` names it; by default the learner's machine.
    #[arg(long, value_name = "NAME")]
    host: Option<String>,
}

/// Tells the supervisor of a run, or its gateway, how many actors are wanted.
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let Arguments { run, actors, host } = arguments;
    let folder = RunFolder::new(run);
    folder.config()?;
    let otherwise = format!("; `train --resume` takes --actors {actors}");
    let trainer = lock::trainer(&folder, &otherwise)?;
    let listens = folder.listening_file().exists();
    let present = Hosts::of_run(&folder).present;
    let Some(host) = host else {
        require_an_actor(*actors, listens)?;
        require_places(*actors, places_of_others(&present, ""))?;
        let (is_here, wanted) = (trainer.machine == node_name(), ActorsWanted::here(&folder));
        if is_here {
            Machine::here().require_room_for_actors("--actors", *actors)?;
        }
        wanted.want(*actors)?;
        if is_here {
            expect_actors(&folder, &wanted, *actors)?;
        }
        print_line(&format!("actors: {actors}"));
        return Ok(());
    };
    require_host(&present, host)?;
    require_places(*actors, actors_here(&folder)? + places_of_others(&present, host))?;
    ActorsWanted::of_host(&folder, host).want(*actors)?;
    print_line(&format!("actors of {host}: {actors}"));
    if let Some(remark) = await_actors(&folder, host, *actors, PATIENCE) {
        print_remark(&remark);
    }
    Ok(())
}

fn actors_here(folder: &RunFolder) -> Result<u64> {
    let address = BusAddress::if_started(folder.path())?;
    let found = address.map(|address| Processes::on(&address)).transpose()?;
    Ok(found.map_or(0, |processes| processes.actors_here() as u64))
}

/// Waits until the run has `actors` actors on the learner's machine, its supervisor refuses them, the run ends, or the
/// supervisor has not refused them within [`ANSWER`].
///
/// # Errors
/// When the supervisor refuses them.
fn expect_actors(folder: &RunFolder, wanted: &ActorsWanted, actors: u64) -> Result<()> {
    let begun = Instant::now();
    while actors_here(folder)? != actors && begun.elapsed() < ANSWER && folder.is_trained() {
        if let Some(kept) = wanted.count()?.filter(|count| *count != actors) {
            bail!(
                "{kept} actors are wanted instead: if nobody else asked for them, see what `goalward train` says"
            );
        }
        std::thread::sleep(LOOK_EVERY);
    }
    Ok(())
}

/// Returns the places of a run that other machines than `host` take, at least one each.
fn places_of_others(present: &[Host], host: &str) -> u64 {
    let others = present.iter().filter(|other| other.name != host);
    others.map(|other| other.actors.max(1)).sum()
}

/// Checks that a run has places for `actors` actors of one machine, besides those that are `taken`.
fn require_places(actors: u64, taken: u64) -> Result<()> {
    let room = (MAX_ACTORS as u64).saturating_sub(taken);
    let words = format!(
        "--actors: expected at most {room}, as other machines take {taken} of the {MAX_ACTORS} places of \
         a run, found {actors}"
    );
    ensure!(actors <= room, wrong_usage(words));
    Ok(())
}

/// Waits until a machine has `actors` actors; returns a remark if that takes longer than `patience` or the run ends
/// before.
fn await_actors(folder: &RunFolder, host: &str, actors: u64, patience: Duration) -> Option<String> {
    let begun = Instant::now();
    loop {
        let present = Hosts::of_run(folder).present;
        let found = present.iter().find(|one| one.name == host).map(|one| one.actors);
        if found == Some(actors) {
            return None;
        }
        if begun.elapsed() >= patience || !folder.is_trained() {
            let Some(found) = found else { return Some(format!("{host} is no longer in the run")) };
            let log = folder.output().join("gateway.log");
            return Some(format!(
                "{host} has {found} actors so far, {actors} are wanted: its `goalward join` or {} may \
                 say why",
                log.display()
            ));
        }
        std::thread::sleep(LOOK_EVERY);
    }
}

fn require_host(present: &[Host], host: &str) -> Result<()> {
    let names: Vec<&str> = present.iter().map(|host| host.name.as_str()).collect();
    let expected = match names.is_empty() {
        true => "expected a machine that has joined the run, and none has".to_owned(),
        false => {
            format!("expected one of the machines that have joined the run, {}", names.join(", "))
        }
    };
    ensure!(names.contains(&host), wrong_usage(format!("--host: {expected}, found {host}")));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn host(name: &str) -> Host {
        Host { name: name.to_owned(), build: String::new(), actors: 2, distance_ms: None }
    }

    #[test]
    fn a_run_has_places_for_so_many_actors() {
        let present = [host("node-1"), Host { actors: 0, ..host("node-2") }];
        assert_eq!(places_of_others(&present, "node-1"), 1);
        assert_eq!(places_of_others(&present, ""), 3);
        require_places(61, 3).unwrap();
        let refused = require_places(62, 3).unwrap_err().to_string();
        assert!(refused.contains("at most 61, as other machines take 3 of the 64"), "{refused}");
    }

    #[test]
    fn a_machine_that_does_not_come_to_what_is_wanted_is_named() {
        let directory = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(directory.path());
        std::fs::create_dir(folder.output()).unwrap();
        Hosts { present: vec![host("node-1")], ..Hosts::default() }.write(&folder).unwrap();
        let remark = |host| await_actors(&folder, host, 2, Duration::ZERO);
        assert_eq!(remark("node-1"), None);
        assert_eq!(remark("node-2").as_deref(), Some("node-2 is no longer in the run"));
        let remark = await_actors(&folder, "node-1", 8, Duration::ZERO).unwrap();
        assert!(remark.starts_with("node-1 has 2 actors so far, 8 are wanted"), "{remark}");
    }

    #[test]
    fn a_machine_that_takes_part_is_named() {
        let present = [host("node-1"), host("node-2")];
        require_host(&present, "node-2").unwrap();
        let refused = |present: &[Host]| require_host(present, "node-7").unwrap_err().to_string();
        let words = "--host: expected one of the machines that have joined the run, node-1, node-2, found node-7";
        assert_eq!(refused(&present), words);
        let words =
            "--host: expected a machine that has joined the run, and none has, found node-7";
        assert_eq!(refused(&[]), words);
    }
}
