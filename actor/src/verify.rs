//! `goalward replay --verify`: every recorded episode is re-simulated from its seeds and actions, and must come
//! out as it was recorded, bit for bit.

use std::time::Instant;

use anyhow::{Context, Result};
use mcap_log::{Contents, Entry, FileReader, read_contents};
use protocol::Error;
use protocol::trajectory::{Encoded, Source, Trajectory};
use run::folder::RunFolder;
use run::lost;
use serde::Serialize;

use crate::episode::is_of_no_episode;
use crate::factory::{Factory, Tasks};
use crate::resimulate::Resimulator;

/// The result of a verification, as it is printed.
#[derive(Debug, Default, Serialize)]
pub(crate) struct Verification {
    /// Episodes re-simulated.
    pub(crate) episodes: u64,
    /// Their steps.
    pub(crate) steps: u64,
    /// Episodes that came out as they were recorded.
    pub(crate) equal: u64,
    /// The first difference, and where it is.
    pub(crate) first_difference: Option<String>,
    /// Files that are unreadable in part, and why.
    pub(crate) damaged: Vec<String>,
    /// Wall time.
    pub(crate) seconds: f64,
}

/// Re-simulates every episode of a run's log, and of the demonstrations that the run recorded itself, on
/// `threads` threads; 0 uses all cores.
///
/// # Errors
/// When the task's episodes cannot be re-simulated, or a file cannot be read. An episode that differs is not an error.
pub(crate) fn verify(tasks: Tasks, folder: &RunFolder, threads: usize) -> Result<Verification> {
    let begun = Instant::now();
    let config = folder.config()?;
    let factory = Factory::for_resimulation(tasks, &config)?;
    let threads = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
    let mut verification = Verification::default();

    let file = folder.demonstrations_file();
    if file.exists() {
        let mut reader = FileReader::open(&file)?;
        let setting = reader.metadata().get("setting").context("demonstrations: setting")?;
        let setting = serde_json::from_str(setting).context("demonstrations: setting")?;
        let resimulator = Resimulator::new(&threads, &factory.with_setting(setting))?;
        verify_all(resimulator, &mut reader, &mut verification)?;
        if let Some(ending) = reader.ending().filter(|ending| ending.lost()) {
            verification.damaged.push(format!("{}: {ending}", file.display()));
        }
    }

    let mut reader = read_contents(&folder.log(), Contents::Trajectories)?;
    let resimulator = Resimulator::new(&threads, &factory)?;
    verify_all(resimulator, &mut reader, &mut verification)?;
    verification.damaged.extend(lost::of_log(folder, &reader));
    verification.seconds = begun.elapsed().as_secs_f64();
    Ok(verification)
}

/// Re-simulates the episodes of a log and notes the results.
fn verify_all(
    mut resimulator: Resimulator<'_>,
    log: impl Iterator<Item = Result<Entry, Error>>,
    verification: &mut Verification,
) -> Result<()> {
    let spec = resimulator.spec();
    let bytes = log.filter_map(|entry| entry.map(|entry| entry.record.trajectory()).transpose());
    let mut episodes = bytes.map(|bytes| Trajectory::recorded(bytes?, &spec));
    loop {
        let some = episodes.by_ref().take(resimulator.episodes_at_once());
        let some: Vec<Trajectory> = some.collect::<Result<_, Error>>()?;
        if some.is_empty() {
            return Ok(());
        }
        for (recorded, difference) in some.iter().zip(resimulator.each(&some, difference)) {
            verification.episodes += 1;
            verification.steps += u64::from(recorded.steps);
            match difference? {
                None => verification.equal += 1,
                Some(difference) => {
                    verification.first_difference.get_or_insert(difference);
                }
            }
        }
    }
}

/// Returns where a re-simulated episode differs from the recorded one, if it does.
///
/// # Errors
/// When this cannot be told, because the environment failed for a reason outside the episode.
fn difference(recorded: &Trajectory, again: Result<Trajectory>) -> Result<Option<String>> {
    let name = name(recorded);
    let mut again = match again {
        Ok(again) => again,
        Err(error) if is_of_no_episode(&error) => return Err(error.context(name)),
        Err(error) => return Ok(Some(format!("{name}: {error:#}"))),
    };
    if recorded.is_actions_only() {
        let hash = Encoded::encode(again.clone()).key.hash;
        again = again.actions_only(hash);
    }
    Ok((again != *recorded).then(|| format!("{name}, {}", first_difference(recorded, &again))))
}

fn name(recorded: &Trajectory) -> String {
    let Trajectory { lane, episode, .. } = recorded;
    let kind = match recorded.source() {
        Source::Training => "",
        Source::Evaluation => "evaluation, ",
        Source::Demonstration => "demonstration, ",
    };
    format!("{kind}lane {lane} episode {episode}")
}

/// Describes the first difference between two episodes, in the order of events.
pub(crate) fn first_difference(recorded: &Trajectory, again: &Trajectory) -> String {
    let observation = position(&observations(recorded), &observations(again));
    match (observation, position(&actions(recorded), &actions(again))) {
        // An action follows the observation with the same index.
        (observation, Some(step)) if observation.is_none_or(|other| step < other) => {
            return format!("step {}: another action", step + 1);
        }
        (Some(step), _) => return format!("step {step}: another observation"),
        (None, _) => {}
    }
    if recorded.steps != again.steps {
        return format!("ending: expected after step {}, found {}", recorded.steps, again.steps);
    }
    let rewards =
        |trajectory: &Trajectory| trajectory.environment_rewards.as_chunks::<4>().0.to_vec();
    let step = rewards(recorded).iter().zip(rewards(again)).position(|(one, other)| *one != other);
    match step {
        Some(step) => format!("step {}: another reward of the environment", step + 1),
        None if recorded.state_hash != again.state_hash => format!(
            "step {}: expected the state {:016x}, found {:016x}",
            recorded.steps, recorded.state_hash, again.state_hash
        ),
        None if recorded.full_hash != again.full_hash => "other observations".to_owned(),
        None => "another ending, success or probability".to_owned(),
    }
}

fn observations(episode: &Trajectory) -> Vec<&[u8]> {
    rows(episode.observations(), episode.steps + 1)
}

fn actions(episode: &Trajectory) -> Vec<&[u8]> {
    rows(episode.actions(), episode.steps)
}

fn rows(bytes: &[u8], count: u32) -> Vec<&[u8]> {
    bytes.chunks_exact((bytes.len() / (count as usize).max(1)).max(1)).collect()
}

/// Returns the index of the first row that differs, among the rows that both have.
fn position(rows: &[&[u8]], others: &[&[u8]]) -> Option<usize> {
    rows.iter().zip(others).position(|(row, other)| row != other)
}
