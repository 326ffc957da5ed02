//! `goalward replay`: replays a run from its log.

mod curves;
mod publish;
mod rescore;
mod retrain;
mod verify;

use std::path::PathBuf;

use anyhow::Result;
use run::folder::RunFolder;

use crate::output_format::OutputFormat;

/// Flags of `goalward replay`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Folder of the run.
    run: PathBuf,
    #[command(flatten)]
    what: What,
    /// Iterations to retrain; by default all in the log.
    #[arg(long, value_name = "ITERATION", conflicts_with_all = ["verify", "publish", "with"])]
    until: Option<u64>,
    /// Speed relative to the recording; by default as fast as readers take trajectories.
    #[arg(long, value_name = "X", conflicts_with_all = ["verify", "retrain", "with"])]
    speed: Option<f64>,
    /// With --retrain, folder for the retrained run, by default one that is removed if all hashes match. With --with,
    /// file for the rewards, by default RUN/rescored.csv.
    #[arg(long, value_name = "PATH", conflicts_with_all = ["verify", "publish"])]
    out: Option<PathBuf>,
    /// Overwrites rewards written earlier, but nothing else of a run.
    #[arg(long, conflicts_with_all = ["verify", "publish", "retrain"])]
    force: bool,
    #[command(flatten)]
    output: OutputFormat,
}

/// What is done with the log, one of these.
#[derive(Debug, clap::Args)]
#[group(required = true, multiple = false)]
struct What {
    /// Re-simulate every recorded episode, on all cores, and compare bit for bit.
    #[arg(long)]
    verify: bool,
    /// Train again from the log alone, without environments, and compare the weights' hashes.
    #[arg(long)]
    retrain: bool,
    /// Publish the recorded trajectories on the run's bus, for any subscriber.
    #[arg(long)]
    publish: bool,
    /// Rescore the recorded episodes with another reward: a key of the reward's configuration, such as
    /// reward.uncertainty=0.1, or model=RUN for the trained model of another run; can be repeated.
    #[arg(long, value_name = "KEY=VALUE")]
    with: Vec<String>,
}

/// Replays a run.
pub(crate) fn run(arguments: Arguments) -> Result<()> {
    let Arguments { run, what, until, speed, out, force, output } = arguments;
    let folder = RunFolder::new(run);
    if what.verify {
        folder.config()?;
        return verify::verify(&folder, output);
    }
    if what.publish {
        return publish::publish(&folder, speed, output);
    }
    if what.retrain {
        return retrain::retrain(&folder, until, out, output);
    }
    rescore::rescore(&folder, &what.with, out, force, output)
}
