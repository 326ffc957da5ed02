//! `goalward log info`, `log repair`, `log restore` and `log scene`: describes recorded files, seals those that a crash
//! left, adds observations to logs that have only actions, and writes episodes for viewers.

mod info;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::{Context, Result};
use bus::BusAddress;
use mcap_log::{Contents, Record, Topic, log_files, read_contents};
use protocol::durable::{self, TemporaryFolder};
use protocol::trajectory::Trajectory;
use run::folder::RunFolder;
use run::holder::Work;
use serde::{Deserialize, Serialize};

use self::info::Holding;
use crate::full_log::{self, Restored};
use crate::lock::Lock;
use crate::output_format::OutputFormat;
use crate::{destination, programs, scenes};
use terminal::numbers;
use terminal::refusal::{Refusal, stopped, wrong_usage};

/// The verbs of `goalward log`.
#[derive(Debug, clap::Subcommand)]
pub(crate) enum Verb {
    /// Describe files and check that they are intact; exit code 3 if one is not.
    Info(Arguments),
    /// Repair and seal files after a crash or a disk fault; exit code 3 if something in them is lost.
    Repair(Arguments),
    /// Rewrite the log of a run that recorded only actions, with its observations.
    Restore {
        /// Folder of the run.
        run: PathBuf,
        /// Folder for the log.
        #[arg(long, value_name = "DIR")]
        out: PathBuf,
        /// Overwrites existing log files of the folder, but nothing of a run.
        #[arg(long)]
        force: bool,
        #[command(flatten)]
        output: OutputFormat,
    },
    /// Write episodes of a run as 3D scenes for Foxglove and Lichtblick.
    Scene {
        /// Folder of the run.
        run: PathBuf,
        /// Lane and number of each episode, such as 3:17.
        #[arg(required = true, value_name = "LANE:EPISODE")]
        episodes: Vec<EpisodeName>,
        /// The file to write.
        #[arg(long, value_name = "FILE.mcap")]
        out: PathBuf,
        /// Overwrites an existing file.
        #[arg(long)]
        force: bool,
        #[command(flatten)]
        output: OutputFormat,
    },
}

/// An episode, by its lane and its number in the lane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct EpisodeName {
    lane: u64,
    episode: u64,
}

impl FromStr for EpisodeName {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers = text.split_once(':').map(|(lane, episode)| [lane, episode].map(str::parse));
        let Some([Ok(lane), Ok(episode)]) = numbers else {
            return Err("expected a lane and an episode, such as 3:17".to_owned());
        };
        Ok(EpisodeName { lane, episode })
    }
}

/// Flags of the verbs that read files.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// MCAP files, or folders of runs.
    #[arg(required = true, value_name = "FILE|RUN")]
    files: Vec<PathBuf>,
    #[command(flatten)]
    output: OutputFormat,
}

/// Runs the verb.
pub(crate) fn run(verb: &Verb) -> Result<()> {
    match verb {
        Verb::Info(arguments) => {
            each(arguments, Holding::of, Holding::text, |found| found.lost.then_some(&found.file))
        }
        Verb::Repair(arguments) => each(
            arguments,
            repaired,
            |file| &file.text,
            |file| (!file.damage.is_empty()).then_some(&file.file),
        ),
        Verb::Restore { run, out, force, output } => {
            restore(&RunFolder::new(run), out, *force, *output)
        }
        Verb::Scene { run, episodes, out, force, output } => {
            destination::file(out, *force)?;
            scene(&RunFolder::new(run), episodes, out, *output)
        }
    }
}

/// Treats all files, including damaged ones, and prints the results before it fails for those that have `lost`
/// something. If a file cannot be treated, the results of those before it are printed, too.
fn each<T: Serialize>(
    Arguments { files, output }: &Arguments,
    treat: impl Fn(&Path) -> Result<T>,
    text: impl Fn(&T) -> &str,
    lost: impl Fn(&T) -> Option<&Path>,
) -> Result<()> {
    let mut treated = Vec::new();
    let refused: Result<()> = files_of(files)?.iter().try_for_each(|file| {
        treated.push(treat(file)?);
        Ok(())
    });
    if !treated.is_empty() {
        output.print(&treated, |all| all.iter().map(&text).collect::<Vec<_>>().join("\n"))?;
    }
    refused?;
    let lost: Vec<_> =
        treated.iter().filter_map(lost).map(|file| file.display().to_string()).collect();
    if lost.is_empty() {
        return Ok(());
    }
    let lost = lost.join(", ");
    Err(Refusal::DataLost(format!("not all that was recorded can be read: {lost}")).into())
}

/// The result of repairing a file.
#[derive(Debug, Serialize)]
struct Repaired {
    file: PathBuf,
    /// The sealed file; `None` if there was nothing to keep.
    sealed: Option<PathBuf>,
    /// Messages kept, by topic.
    kept: BTreeMap<&'static str, u64>,
    damage: Vec<String>,
    lost: u64,
    #[serde(skip)]
    text: String,
}

fn repaired(file: &Path) -> Result<Repaired> {
    // A link is followed: its target is sealed under its own name, where it is.
    let sealed = &fs::canonicalize(file)
        .map_err(|error| wrong_usage(format!("{}: {error}", file.display())))?;
    let _held = hold_run(sealed)?;
    let repair = mcap_log::repair(sealed).map_err(Refusal::usage)?;
    let kept = |(topic, &count): (&Topic, &u64)| (topic.name(), count);
    Ok(Repaired {
        file: file.to_owned(),
        text: repair.to_string(),
        kept: repair.kept.iter().map(kept).collect(),
        sealed: repair.sealed,
        damage: repair.damage,
        lost: repair.lost,
    })
}

/// A log with observations.
#[derive(Debug, Serialize)]
struct WithObservations {
    folder: PathBuf,
    episodes: u64,
    /// Episodes that were acted again.
    restored: u64,
}

fn restore(run: &RunFolder, out: &Path, force: bool, output: OutputFormat) -> Result<()> {
    run.config()?;
    destination::folder(out, force)?;
    let made = durable::create_folder(durable::folder_of(out))
        .and_then(|()| TemporaryFolder::beside(out))
        .with_context(|| out.display().to_string())?;
    let Restored { episodes, restored } = full_log::restore(run, made.path())?;
    put_in_place(made.path(), out).with_context(|| out.display().to_string())?;
    let written = WithObservations { folder: out.to_owned(), episodes, restored };
    output.print(&written, |WithObservations { folder, episodes, restored }| {
        let [episodes, restored] = [episodes, restored].map(|count| numbers::count(*count));
        format!("{}: {episodes} episodes, {restored} re-simulated", folder.display())
    })?;
    full_log::refuse_loss(run)
}

/// Moves a complete log into a folder, in place of the log files that are there.
fn put_in_place(made: &Path, out: &Path) -> Result<()> {
    durable::create_folder(out)?;
    for file in log_files(out)? {
        fs::remove_file(&file.path)?;
    }
    for file in log_files(made)? {
        let name = file.path.file_name().context("a log file has a name")?;
        durable::rename(&file.path, &out.join(name))?;
    }
    Ok(())
}

/// The lanes of a log, each with its first and its last episode.
#[derive(Debug, Default)]
struct Lanes(BTreeMap<u64, [u64; 2]>);

impl Lanes {
    fn add(&mut self, EpisodeName { lane, episode }: EpisodeName) {
        let [first, last] = self.0.entry(lane).or_insert([episode; 2]);
        *first = episode.min(*first);
        *last = episode.max(*last);
    }

    /// Says which lanes there are, and which episodes one of them has.
    fn text(&self, lane: u64) -> String {
        let ends = self.0.first_key_value().zip(self.0.last_key_value());
        let Some(((first, _), (last, _))) = ends else { return "none".to_owned() };
        let lanes = format!("lanes {first} to {last}");
        match self.0.get(&lane) {
            Some([first, last]) => format!("{lanes}, lane {lane} with episodes {first} to {last}"),
            None => lanes,
        }
    }
}

/// The actor's report about scenes.
#[derive(Debug, Deserialize, Serialize)]
struct Written {
    episodes: u64,
    frames: u64,
}

fn scene(run: &RunFolder, named: &[EpisodeName], out: &Path, output: OutputFormat) -> Result<()> {
    let task = run.config()?.task;
    let spec = task.spec();
    let (mut found, mut lanes) = (vec![None; named.len()], Lanes::default());
    for entry in read_contents(&run.log(), Contents::Trajectories).map_err(Refusal::usage)? {
        let Record::Trajectory(bytes) = entry?.record else { continue };
        let trajectory = Trajectory::recorded(bytes, &spec)?;
        let Trajectory { lane, episode, .. } = trajectory;
        let name = EpisodeName { lane, episode };
        lanes.add(name);
        for (_, place) in named.iter().zip(&mut found).filter(|(wanted, _)| **wanted == name) {
            *place = Some(trajectory.clone());
        }
    }
    let found = named.iter().zip(found).map(|(&EpisodeName { lane, episode }, found)| {
        found.ok_or_else(|| {
            let (shown, there) = (run.path().display(), lanes.text(lane));
            let wanted = format!("expected an episode {lane}:{episode}, found {there}");
            wrong_usage(format!("{shown}: {wanted}"))
        })
    });
    let episodes = found.collect::<Result<Vec<_>>>()?;
    // An existing file stays until there is something in its place.
    let made = TemporaryFolder::beside(out).with_context(|| out.display().to_string())?;
    let file = made.path().join("scene.mcap");
    let (mut actor, input) = scenes::command(run, None, &episodes, true, &file)?;
    let ended = programs::run_for_unless_stopped(&mut actor, "acting again", &input)?;
    let written: Written = ended.ok_or_else(stopped)?.result()?;
    if written.frames == 0 {
        return Err(wrong_usage(format!(
            "{task} has no solids to draw; `goalward page` shows its episodes"
        )));
    }
    durable::rename(&file, out).with_context(|| out.display().to_string())?;
    output.print(&written, |Written { episodes, frames }| {
        let [episodes, frames] = [episodes, frames].map(|count| numbers::count(*count));
        format!("{}: {episodes} episodes, {frames} frames", out.display())
    })
}

/// Returns the named files, and the log files of the named runs.
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

/// Locks the run that a file belongs to against training, until the returned lock is dropped: a file must not be sealed
/// while its writer is at work. Returns `None` for a file of no run.
fn hold_run(file: &Path) -> Result<Option<Lock>> {
    // The file is in the folder of a run, or in its log.
    let folders = file.ancestors().skip(1).take(2).map(RunFolder::new);
    let Some(folder) = folders.into_iter().find(|folder| folder.config_file().exists()) else {
        return Ok(None);
    };
    let held = Lock::take(&folder, Work::Repairing)?;
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
    fn lanes_are_told_with_the_episodes_of_one() {
        let mut lanes = Lanes::default();
        assert_eq!(lanes.text(3), "none");
        for name in ["3:1", "0:0", "3:0", "31:2", "3:2"] {
            lanes.add(name.parse().unwrap());
        }
        assert_eq!(lanes.text(3), "lanes 0 to 31, lane 3 with episodes 0 to 2");
        assert_eq!(lanes.text(32), "lanes 0 to 31");
    }

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
