//! The command line of `goalward-actor`. Users type `goalward`, which starts it.

use std::io::{Read, Write};
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context, Result, ensure};
use bytes::Bytes;
use clap::{Parser, Subcommand};
use environments::{Registration, Setting};
use run::config::ActionChoice;
use run::diagnostics::Diagnostics;
use run::folder::RunFolder;
use run::process::{self, Stop};
use serde::Serialize;

use crate::demonstrate::{Request, demonstrate};
use crate::describe::describe;
use crate::evaluate::{Wanted, evaluate};
use crate::expert::ActingExpert;
use crate::factory::{Factory, Tasks};
use crate::replay::{Recording, replay};

/// Acts in environments.
#[derive(Debug, Parser)]
#[command(name = "goalward-actor", version = protocol::build::version())]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Runs leases of a run's learner and publishes their trajectories.
    Rollout {
        /// Folder of the run.
        #[arg(long)]
        run: PathBuf,
        /// Name on the bus, followed by the process's number: actor-0, actor-1 and so on.
        #[arg(long)]
        name: String,
    },
    /// Takes leases of a run's learner and publishes what a log has of them.
    Replay {
        /// Folder of the run that learns.
        #[arg(long)]
        run: PathBuf,
        /// Name on the bus.
        #[arg(long)]
        name: String,
        /// Folder of the log.
        #[arg(long)]
        log: PathBuf,
        /// Iterations to replay; without it the whole log.
        #[arg(long)]
        iterations: Option<u64>,
    },
    /// Publishes the trajectories of a run's log for whoever listens on its bus.
    Publish {
        /// Folder of the run.
        #[arg(long)]
        run: PathBuf,
        /// Folder of the log.
        #[arg(long)]
        log: PathBuf,
        /// Times the pace of the recording; without it as fast as readers take them.
        #[arg(long)]
        speed: Option<f64>,
    },
    /// Prints what a task is, as JSON: `{"Ok": DESCRIPTION}`, or `{"Err": WORDS}` where the program does
    /// not have the task, or the task not the setting.
    Describe {
        /// The task.
        task: String,
        /// What its environment is made with, as JSON.
        #[arg(long, default_value = "{}")]
        environment: String,
        /// What it is made with where demonstrations are recorded, as JSON.
        #[arg(long, default_value = "{}")]
        demonstrations: String,
    },
    /// Records demonstrations by the task's expert.
    Demonstrate {
        /// The task.
        task: String,
        /// How many.
        #[arg(long)]
        episodes: u64,
        /// What the environment is made with, as JSON.
        #[arg(long, default_value = "{}")]
        setting: String,
        /// Folder of the run whose policy demonstrates; without it the task's own expert does.
        #[arg(long)]
        policy: Option<PathBuf>,
        /// Seed of the starts.
        #[arg(long, default_value_t = 1)]
        seed: u64,
        /// The file to write.
        #[arg(long)]
        out: PathBuf,
        /// Replaces a file that is there once the new one is whole.
        #[arg(long)]
        force: bool,
    },
    /// Holds environments of a task for another program: frames of `actor/src/frame.rs` on standard input and
    /// output.
    Serve {
        /// The task.
        task: String,
        /// What the environments are made with, as JSON.
        #[arg(long, default_value = "{}")]
        setting: String,
    },
    /// Runs evaluation episodes with a checkpoint of a run.
    Evaluate {
        /// Folder of the run.
        #[arg(long)]
        run: PathBuf,
        /// How many.
        #[arg(long)]
        episodes: u64,
        /// How actions are chosen; by default as at the end of training.
        #[arg(long)]
        actions: Option<ActionChoice>,
        /// Seed of the episodes, where it is not the run's.
        #[arg(long)]
        seed: Option<u64>,
        /// Iterations that the checkpoint is after; without it the newest.
        #[arg(long)]
        checkpoint: Option<u64>,
        /// The file to write; by default one in the run's folder.
        #[arg(long)]
        out: Option<PathBuf>,
        /// Lets a Python module of the environment have changed since training.
        #[arg(long)]
        other_build: bool,
    },
    /// Acts recorded episodes of a run again, which standard input has, each behind its length, and writes
    /// them with what a viewer draws of them.
    Scenes {
        /// Folder of the run.
        #[arg(long)]
        run: PathBuf,
        /// What the environment was made with, as JSON; without it as the run's own.
        #[arg(long)]
        setting: Option<String>,
        /// Has an environment of Python render pictures.
        #[arg(long)]
        pictures: bool,
        /// The file to write.
        #[arg(long)]
        out: PathBuf,
    },
    /// Writes the policy of a run as a file that other programs read.
    Export {
        /// Folder of the run.
        #[arg(long)]
        run: PathBuf,
        /// Iterations that its checkpoint is after; without it the newest.
        #[arg(long)]
        checkpoint: Option<u64>,
        /// The file, `.onnx` or `.safetensors`.
        #[arg(long)]
        out: PathBuf,
    },
    /// Prints a hash of a few episodes, which is the same on every machine that can act in a run.
    Golden {
        /// Folder of the run.
        #[arg(long)]
        run: PathBuf,
    },
    /// Acts episodes again that another machine acted, which standard input has with their weights, and prints
    /// how each differs, as JSON.
    Audit {
        /// Folder of the run.
        #[arg(long)]
        run: PathBuf,
    },
    /// Acts every recorded episode of a run again and compares.
    Verify {
        /// Folder of the run.
        #[arg(long)]
        run: PathBuf,
        /// Threads; 0 takes all cores.
        #[arg(long, default_value_t = 0)]
        threads: usize,
    },
    /// Writes a run's log once more, with the observations it left out.
    Restore {
        /// Folder of the run.
        #[arg(long)]
        run: PathBuf,
        /// Folder for the log.
        #[arg(long)]
        out: PathBuf,
        /// Threads; 0 takes all cores.
        #[arg(long, default_value_t = 0)]
        threads: usize,
    },
}

impl Command {
    /// Returns the form of diagnostics: lines of a log file for an actor of a run, unless a terminal shows them;
    /// lines for people for a command that `goalward` starts for a single job.
    fn diagnostics(&self) -> Diagnostics {
        match self {
            Command::Rollout { .. } | Command::Replay { .. } => Diagnostics::of_service(),
            _ => Diagnostics::ForPeople,
        }
    }
}

/// Runs an actor process that can act in these tasks, as its command line says.
pub fn main(tasks: &'static [Registration]) -> ExitCode {
    let arguments = Arguments::parse();
    process::run(arguments.command.diagnostics(), || {
        let outcome = run(arguments.command, tasks);
        crate::python::close();
        outcome
    })
}

fn run(command: Command, tasks: Tasks) -> Result<()> {
    match command {
        Command::Rollout { run, name } => {
            check_name(&name)?;
            let stop = Stop::at_end_of_input()?;
            crate::rollout::rollout(tasks, &RunFolder::new(run), &name, &stop)
        }
        Command::Replay { run, name, log, iterations } => {
            check_name(&name)?;
            let recording = Recording { log, iterations };
            replay(&RunFolder::new(run), &name, &recording, &Stop::at_end_of_input()?)
        }
        Command::Publish { run, log, speed } => {
            let stop = Stop::at_end_of_input()?;
            print(&crate::publish::publish(&RunFolder::new(run), &log, speed, &stop)?)
        }
        Command::Describe { task, environment, demonstrations } => {
            let environment = setting_of(&environment, "--environment")?;
            let demonstrations = setting_of(&demonstrations, "--demonstrations")?;
            let described = describe(tasks, &task, environment, demonstrations);
            print(&described.map_err(|refusal| format!("{refusal:#}")))
        }
        Command::Demonstrate { task, episodes, setting, policy, seed, out, force } => {
            ensure!(episodes > 0, "expected at least 1 episode, found 0");
            let factory = Factory::new(tasks, &task, setting_of(&setting, "--setting")?)?;
            let expert = match policy {
                Some(run) => ActingExpert::of_run(&RunFolder::new(run), &task)?,
                None => ActingExpert::of_task(&factory)?,
            };
            let request = Request { factory, episodes, seed, file: &out, force };
            print(&demonstrate(&request, expert, &Stop::at_end_of_input()?)?)
        }
        Command::Serve { task, setting } => {
            let factory = Factory::new(tasks, &task, setting_of(&setting, "--setting")?)?;
            crate::serve::serve(&factory, &mut std::io::stdin(), &mut std::io::stdout())
        }
        Command::Evaluate { run, episodes, actions, seed, checkpoint, out, other_build } => {
            ensure!(episodes > 0, "expected at least 1 episode, found 0");
            process::end_with_parent()?;
            let (other_seed, file) = (seed, out);
            let wanted = Wanted { episodes, actions, other_seed, checkpoint, file, other_build };
            print(&evaluate(tasks, &RunFolder::new(run), wanted)?)
        }
        Command::Scenes { run, setting, pictures, out } => {
            let setting = setting.map(|json| setting_of(&json, "--setting")).transpose()?;
            let (run, episodes) = (RunFolder::new(run), standard_input()?);
            print(&crate::scenes::write(tasks, &run, setting, pictures, episodes, &out)?)
        }
        Command::Export { run, checkpoint, out } => {
            print(&crate::export::export(&RunFolder::new(run), checkpoint, &out)?)
        }
        Command::Golden { run } => {
            process::end_with_parent()?;
            print(&crate::golden::golden(tasks, &RunFolder::new(run))?)
        }
        Command::Audit { run } => {
            let (mut input, mut output) = (std::io::stdin().lock(), std::io::stdout());
            crate::audit::audit(tasks, &RunFolder::new(run), &mut input, &mut output)
        }
        Command::Verify { run, threads } => {
            process::end_with_parent()?;
            print(&crate::verify::verify(tasks, &RunFolder::new(run), threads)?)
        }
        Command::Restore { run, out, threads } => {
            process::end_with_parent()?;
            print(&crate::restore::restore(tasks, &RunFolder::new(run), &out, threads)?)
        }
    }
}

fn standard_input() -> Result<Bytes> {
    let mut bytes = Vec::new();
    std::io::stdin().read_to_end(&mut bytes).context("standard input")?;
    Ok(bytes.into())
}

fn setting_of(json: &str, flag: &'static str) -> Result<Setting> {
    serde_json::from_str(json).context(flag)
}

fn check_name(name: &str) -> Result<()> {
    ensure!(name.starts_with("actor"), "expected a name like actor-0, found {name}");
    Ok(())
}

/// Prints a result for `goalward`, as JSON.
fn print(result: &impl Serialize) -> Result<()> {
    Ok(writeln!(std::io::stdout(), "{}", serde_json::to_string(result)?)?)
}
