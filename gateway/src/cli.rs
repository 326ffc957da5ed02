//! The command line of `goalward-gateway`. People type `goalward train --listen` and `goalward join`, which
//! start it.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Result;
use clap::{Args, Parser, Subcommand};
use run::diagnostics::Diagnostics;
use run::folder::RunFolder;
use run::process::{self, Stop};

use crate::host::{self, Identity};
use crate::hub::{self, Audit, Setup};
use crate::key::{self, JoinKey};

/// Takes a run's leases, trajectories and weights to other machines and back.
#[derive(Debug, Parser)]
#[command(name = "goalward-gateway", version = protocol::build::version())]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Serves other machines beside the learner of a run.
    Serve {
        /// Folder of the run.
        #[arg(long)]
        run: PathBuf,
        /// Where to listen.
        #[arg(long)]
        listen: SocketAddr,
        /// Where other machines find it, HOST:PORT.
        #[arg(long)]
        address: String,
        /// What `goalward-actor golden` prints here.
        #[arg(long)]
        golden: String,
        /// Share of what hosts deliver that is re-simulated here, in [0, 1].
        #[arg(long, default_value_t = 0.0)]
        audit: f64,
        /// The program that acts in the run's task; without it nothing is re-simulated.
        #[arg(long)]
        actor: Option<PathBuf>,
    },
    /// Lays out the folder of a run that another machine trains.
    LayOut(Place),
    /// Takes part in a run that another machine trains, for the actors of such a folder.
    Join {
        #[command(flatten)]
        place: Place,
        /// What this machine is called.
        #[arg(long)]
        host: String,
        /// What `goalward-actor golden` prints here.
        #[arg(long)]
        golden: String,
        /// Joins with another build whose golden episodes are the same.
        #[arg(long)]
        other_build: bool,
        /// How many actors this machine is to have.
        #[arg(long)]
        actors: u64,
    },
}

/// A host's folder for a run, and the hub.
#[derive(Debug, Args)]
struct Place {
    /// The folder.
    #[arg(long)]
    run: PathBuf,
    /// The run's file join.toml.
    #[arg(long)]
    key: PathBuf,
    /// Where the hub is, if not where the key says.
    #[arg(long)]
    address: Option<String>,
}

impl Place {
    fn read(self) -> Result<(RunFolder, JoinKey)> {
        let mut key = JoinKey::of_file(&self.key)?;
        key.address = self.address.unwrap_or(key.address);
        Ok((RunFolder::new(self.run), key))
    }
}

impl Command {
    fn diagnostics(&self) -> Diagnostics {
        match self {
            Command::LayOut(_) => Diagnostics::ForPeople,
            Command::Serve { .. } | Command::Join { .. } => Diagnostics::of_service(),
        }
    }
}

/// Runs the gateway process.
pub fn main() -> ExitCode {
    let arguments = Arguments::parse();
    process::run(arguments.command.diagnostics(), || run(arguments.command))
}

fn run(command: Command) -> Result<()> {
    match command {
        Command::Serve { run, listen, address, golden, audit: share, actor } => {
            let stop = Stop::at_end_of_input()?;
            let folder = RunFolder::new(run);
            let hub_key = key::of_run(&folder, &address)?;
            let audit = actor.filter(|_| share > 0.0).map(|program| Audit { share, program });
            hub::serve(&Setup { folder, listen, golden, audit }, &hub_key, &stop)
        }
        Command::LayOut(place) => {
            process::end_with_parent()?;
            let (folder, key) = place.read()?;
            host::lay_out(&folder, &key)
        }
        Command::Join { place, host, golden, other_build, actors } => {
            let stop = Stop::at_end_of_input()?;
            let (folder, key) = place.read()?;
            let identity = Identity { host, golden, other_build, actors };
            host::join(&folder, &key, identity, &stop)
        }
    }
}
