//! `goalward scale`: more or fewer actors for a run that is being trained.

use std::path::PathBuf;

use anyhow::{Result, ensure};
use protocol::MAX_ACTORS;
use run::actors_wanted::ActorsWanted;
use run::folder::RunFolder;
use run::hosts::{Host, Hosts};

use crate::listening::require_an_actor;
use crate::machine::Machine;
use terminal::print::print_line;
use terminal::refusal::wrong_usage;

/// Flags of `goalward scale`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Folder of the run.
    run: PathBuf,
    /// Actor processes from now on; none needs actors of other machines.
    #[arg(long, value_parser = clap::value_parser!(u64).range(..=MAX_ACTORS as u64))]
    actors: u64,
    /// The machine that is to have them, as `goalward status` names it; by default the one that learns.
    #[arg(long, value_name = "NAME")]
    host: Option<String>,
}

/// Tells the supervisor of a run, or its gateway, how many actors there are to be.
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let Arguments { run, actors, host } = arguments;
    let folder = RunFolder::new(run);
    folder.config()?;
    if !folder.is_trained() {
        return Err(wrong_usage(format!(
            "nobody trains the run in {}; --resume takes --actors {actors}",
            run.display()
        )));
    }
    let Some(host) = host else {
        // A run whose gateway keeps no hosts lets nobody in.
        require_an_actor(*actors, folder.hosts_file().exists())?;
        Machine::here().require_room_for_actors(*actors)?;
        ActorsWanted::here(&folder).want(*actors)?;
        print_line(&format!("actors: {actors}"));
        return Ok(());
    };
    require_host(&Hosts::of_run(&folder).present, host)?;
    ActorsWanted::of_host(&folder, host).want(*actors)?;
    print_line(&format!("actors of {host}: {actors}"));
    Ok(())
}

fn require_host(present: &[Host], host: &str) -> Result<()> {
    let names: Vec<&str> = present.iter().map(|host| host.name.as_str()).collect();
    let expected = match names.is_empty() {
        true => "expected a machine that takes part, and none does".to_owned(),
        false => format!("expected one of the machines that take part, {}", names.join(", ")),
    };
    ensure!(names.contains(&host), wrong_usage(format!("--host: {expected}, found {host}")));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_machine_that_takes_part_is_named() {
        let host = |name: &str| Host {
            name: name.to_owned(),
            build: String::new(),
            actors: 2,
            distance_ms: None,
        };
        let present = [host("node-1"), host("node-2")];
        require_host(&present, "node-2").unwrap();
        let refused = |present: &[Host]| require_host(present, "node-7").unwrap_err().to_string();
        let words =
            "--host: expected one of the machines that take part, node-1, node-2, found node-7";
        assert_eq!(refused(&present), words);
        let words = "--host: expected a machine that takes part, and none does, found node-7";
        assert_eq!(refused(&[]), words);
    }
}
