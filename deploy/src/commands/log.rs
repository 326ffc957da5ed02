//! `goalward log info`, `log repair` and `log restore`: what recorded files hold, sealing those that a
//! crash left, and observations for those that have actions only.

use std::fs::{self, File};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use bus::BusAddress;
use mcap_log::{is_active, log_files};
use run::folder::RunFolder;

use crate::full_log::{self, Restored};
use crate::{destination, plan};
use terminal::numbers;
use terminal::print::print_line;
use terminal::refusal::{Refusal, wrong_usage};

/// The verbs of `goalward log`.
#[derive(Debug, clap::Subcommand)]
pub(crate) enum Verb {
    /// Say what files hold and whether they are whole; exit code 3 if one is not.
    Info(Arguments),
    /// Seal files that a crash or a bad disk left; exit code 3 if something in them is lost.
    Repair(Arguments),
    /// Write the log of a run that recorded actions only once more, with its observations.
    Restore {
        /// Folder of the run.
        run: PathBuf,
        /// Folder for the log.
        #[arg(long, value_name = "DIR")]
        out: PathBuf,
        /// Replaces the log files of the folder; never anything of a run.
        #[arg(long)]
        force: bool,
    },
}

/// Flags of both.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// MCAP files, or folders of runs.
    #[arg(required = true, value_name = "FILE|RUN")]
    files: Vec<PathBuf>,
}

/// Does what the verb says to every file.
pub(crate) fn run(verb: &Verb) -> Result<()> {
    match verb {
        Verb::Info(arguments) => each(arguments, info),
        Verb::Repair(arguments) => each(arguments, repair),
        Verb::Restore { run, out, force } => restore(&RunFolder::new(run), out, *force),
    }
}

/// Goes through all files, the damaged ones too, before it says that data is lost.
fn each(arguments: &Arguments, treat: impl Fn(&Path) -> Result<bool>) -> Result<()> {
    let mut lost = Vec::new();
    for file in files_of(&arguments.files)? {
        if treat(&file)? {
            lost.push(file.display().to_string());
        }
    }
    if lost.is_empty() {
        return Ok(());
    }
    Err(Refusal::DataLost(format!("not all that was recorded can be read: {}", lost.join(", ")))
        .into())
}

fn info(file: &Path) -> Result<bool> {
    let Some(info) = mcap_log::info(file).map_err(Refusal::usage)? else {
        print_line(&format!("{}: ends before it says what it is", file.display()));
        // The first thing that a writer does is to create its file.
        return Ok(!is_active(file));
    };
    print_line(&info.to_string());
    Ok(info.ending.lost())
}

fn repair(file: &Path) -> Result<bool> {
    // A link is not the file: that is sealed under its own name, where it lies.
    let file = &fs::canonicalize(file)
        .map_err(|error| wrong_usage(format!("{}: {error}", file.display())))?;
    let _held = hold_run(file)?;
    let repair = mcap_log::repair(file).map_err(Refusal::usage)?;
    print_line(&repair.to_string());
    Ok(!repair.damage.is_empty())
}

fn restore(run: &RunFolder, out: &Path, force: bool) -> Result<()> {
    run.config()?;
    destination::folder(out, force)?;
    for file in log_files(out).unwrap_or_default() {
        fs::remove_file(&file.path).with_context(|| format!("removing {}", file.path.display()))?;
    }
    let Restored { episodes, restored } = full_log::restore(run, out)?;
    let [episodes, restored] = [episodes, restored].map(numbers::count);
    print_line(&format!("{}: {episodes} episodes, {restored} acted again", out.display()));
    full_log::refuse_loss(run)
}

/// The files named, and those of the runs named.
fn files_of(named: &[PathBuf]) -> Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for path in named {
        if !path.is_dir() {
            files.push(path.clone());
            continue;
        }
        let folder = RunFolder::new(path);
        let folder = if folder.log().is_dir() { folder.log() } else { path.clone() };
        let found = log_files(&folder).map_err(Refusal::usage)?;
        if found.is_empty() {
            return Err(wrong_usage(format!(
                "expected files such as trajectories-00000.mcap, found none in {}",
                folder.display()
            )));
        }
        files.extend(found.into_iter().map(|file| file.path));
    }
    Ok(files)
}

/// Keeps everybody from training the run that a file is of, for as long as what is returned lives: a
/// file must not be sealed under its writer's hands. Nothing for a file of no run.
fn hold_run(file: &Path) -> Result<Option<File>> {
    // In the folder of a run, or in its log.
    let folders = file.ancestors().skip(1).take(2).map(RunFolder::new);
    let Some(folder) = folders.into_iter().find(|folder| folder.config_file().exists()) else {
        return Ok(None);
    };
    let held = plan::lock(&folder)?;
    if let Some(address) = BusAddress::if_started(folder.path())?
        && address.is_anyone_alive()?
    {
        let shown = folder.path().display();
        return Err(wrong_usage(format!("processes of the run in {shown} are still alive")));
    }
    Ok(Some(held))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_stands_for_its_files() {
        let directory = tempfile::tempdir().unwrap();
        let log = RunFolder::new(directory.path()).log();
        fs::create_dir(&log).unwrap();
        let run = directory.path().to_owned();
        assert!(files_of(std::slice::from_ref(&run)).is_err());
        for name in ["updates-00000.mcap", "trajectories-00000.mcap.active", "notes.txt"] {
            fs::write(log.join(name), "").unwrap();
        }
        let named = [run, PathBuf::from("other.mcap")];
        let expected = [
            log.join("trajectories-00000.mcap.active"),
            log.join("updates-00000.mcap"),
            PathBuf::from("other.mcap"),
        ];
        assert_eq!(files_of(&named).unwrap(), expected);
    }
}
