//! The episodes of a run's log, of its demonstrations or of an evaluation: the result of each, and where it is stored.
//!
//! Each file is read once, and its new records as it grows. Only a row is kept of each episode.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use bytes::Bytes;
use mcap_log::{Contents, Ending, FileReader, Record, log_files};
use prost::Message;
use protocol::Error;
use protocol::messages::Score;
use protocol::task::Spec;
use protocol::trajectory::{Source, Trajectory};
use serde::Serialize;

/// The names of a row's values.
const COLUMNS: [&str; 13] = [
    "source",
    "iteration",
    "lane",
    "episode",
    "policy_version",
    "steps",
    "ending",
    "success",
    "steps_to_goal",
    "return",
    "environment_return",
    "proximity",
    "uncertainty",
];

/// A value for each of [`COLUMNS`]. Success is `None` if the task does not tell it.
type Row = (
    i32,
    u64,
    u64,
    u64,
    u64,
    u32,
    i32,
    Option<bool>,
    u32,
    Option<f32>,
    f32,
    Option<f32>,
    Option<f32>,
);

/// Number of lines that are kept about damage.
const DAMAGE_KEPT: usize = 10;

/// What identifies an episode: source, lane and number.
type Name = (i32, u64, u64);

/// Where a record is stored: the index of its file in [`Episodes::readers`], and the offset of its chunk.
type Place = (usize, u64);

/// What is kept in memory of an episode.
#[derive(Debug)]
struct Episode {
    source: i32,
    iteration: u64,
    lane: u64,
    number: u64,
    policy_version: u64,
    steps: u32,
    ending: i32,
    success: bool,
    steps_to_goal: u32,
    environment_return: f32,
    trajectory: Place,
    score: Option<Scored>,
}

/// What is kept in memory of a score.
#[derive(Debug)]
struct Scored {
    /// Sum of the rewards.
    scored_return: f32,
    /// The last proximity of the episode.
    proximity: Option<f32>,
    /// Mean uncertainty of the episode.
    uncertainty: Option<f32>,
    place: Place,
}

impl Episode {
    fn row(&self, tells_success: bool) -> Row {
        let scored = self.score.as_ref();
        (
            self.source,
            self.iteration,
            self.lane,
            self.number,
            self.policy_version,
            self.steps,
            self.ending,
            tells_success.then_some(self.success),
            self.steps_to_goal,
            scored.map(|score| score.scored_return),
            self.environment_return,
            scored.and_then(|score| score.proximity),
            scored.and_then(|score| score.uncertainty),
        )
    }
}

/// The episodes of some files, in the order in which they were recorded.
#[derive(Default)]
pub(crate) struct Episodes {
    readers: Vec<(PathBuf, FileReader)>,
    listed: Vec<Episode>,
    by_name: HashMap<Name, usize>,
    /// Iteration of the training episode that was recorded last.
    newest: u64,
    /// Number of leading rows that are final, unless an episode is recorded again or scored later than expected.
    settled: usize,
    /// Incremented whenever rows that were handed out may have changed, for example after a process died.
    generation: u64,
    /// What cannot be read of the files, the first [`DAMAGE_KEPT`] lines.
    damage: Vec<String>,
    /// Files that could not be opened or followed the last time, a line each.
    trouble: Vec<String>,
}

/// Rows from index `from` on, as a browser gets them. Rows of another generation are invalid.
#[derive(Serialize)]
pub(crate) struct Rows<'a> {
    columns: [&'static str; COLUMNS.len()],
    generation: u64,
    from: usize,
    rows: Vec<Row>,
    trouble: Vec<&'a str>,
}

/// An episode as it was recorded, with the recorded score, if any.
pub(crate) struct Recorded {
    pub(crate) trajectory: Trajectory,
    pub(crate) score: Option<Score>,
}

impl Episodes {
    /// Returns no episodes yet. Their first generation is a number that no other run's episodes have.
    pub(crate) fn of_generation(generation: u64) -> Episodes {
        Episodes { generation, ..Episodes::default() }
    }

    /// Reads what was appended to a run's log since the last call.
    pub(crate) fn read_log(&mut self, folder: &Path) {
        self.trouble.clear();
        self.go_on();
        // A run that has only begun has no log yet, which is not an error.
        let files = if folder.exists() { log_files(folder) } else { Ok(Vec::new()) };
        let files = files.unwrap_or_else(|error| {
            self.trouble.push(error.to_string());
            Vec::new()
        });
        let files = files.into_iter().filter(|file| file.contents == Contents::Trajectories);
        self.read_new(files.map(|file| file.path));
    }

    /// Reads what was appended to a file since the last call.
    pub(crate) fn read_file(&mut self, file: PathBuf) {
        self.trouble.clear();
        self.go_on();
        self.read_new(std::iter::once(file));
    }

    /// Reads new records in the known files. Forgets all files if one was replaced, for example by a repair, which
    /// moves records.
    fn go_on(&mut self) {
        for place in 0..self.readers.len() {
            match self.readers[place].1.go_on() {
                Ok(true) => self.read_on(place),
                Ok(false) => {
                    let generation = self.generation + 1;
                    *self = Episodes::of_generation(generation);
                    return;
                }
                Err(error) => self.trouble.push(error.to_string()),
            }
        }
    }

    /// Opens and reads the files that are not known yet.
    fn read_new(&mut self, files: impl Iterator<Item = PathBuf>) {
        let sealed = |path: &Path| path.with_extension("");
        for path in files {
            let is_known = |known: &PathBuf| *known == path || sealed(known) == path;
            if self.readers.iter().any(|(known, _)| is_known(known)) {
                continue;
            }
            match FileReader::open(&path) {
                Ok(reader) => {
                    self.readers.push((path, reader));
                    self.read_on(self.readers.len() - 1);
                }
                // The metadata of a file that is being written may not be there yet.
                Err(_) if mcap_log::is_active(&path) => {}
                Err(error) => self.trouble.push(error.to_string()),
            }
        }
        self.settle();
    }

    /// Returns the rows from index `from` on; all rows if `generation`, which the browser has, is not the current one.
    /// They have no success if the task does not tell it.
    pub(crate) fn rows(&self, generation: u64, from: usize, tells_success: bool) -> Rows<'_> {
        let from = if generation == self.generation { from.min(self.settled) } else { 0 };
        let rows = self.listed[from..self.settled].iter();
        let rows = rows.map(|episode| episode.row(tells_success)).collect();
        let generation = self.generation;
        let trouble = self.damage.iter().chain(&self.trouble).map(String::as_str).collect();
        Rows { columns: COLUMNS, generation, from, rows, trouble }
    }

    /// Returns the environment's setting in the metadata of the first file, as JSON. A run's log has none.
    pub(crate) fn setting(&self) -> Option<String> {
        let (_, reader) = self.readers.first()?;
        reader.metadata().get("setting").map(str::to_owned)
    }

    /// Reads an episode from its file; returns `None` if there is no such row.
    ///
    /// # Errors
    /// When the episode is not where it was, or does not match the task.
    pub(crate) fn recorded(&self, row: usize, spec: &Spec) -> Option<Result<Recorded>> {
        Some(self.recorded_at(self.listed.get(row)?, spec))
    }

    fn recorded_at(&self, episode: &Episode, spec: &Spec) -> Result<Recorded> {
        let name = (episode.lane, episode.number);
        let wanted: Name = (episode.source, episode.lane, episode.number);
        let records = self.records_at(episode.trajectory)?.into_iter();
        let mut trajectories = records.filter_map(Record::trajectory);
        let is_it = |bytes: &Bytes| {
            let other = Trajectory::decode(bytes.clone());
            other.is_ok_and(|other| (other.source, other.lane, other.episode) == wanted)
        };
        let bytes = trajectories.find(is_it).context("expected an episode where it was")?;
        let trajectory = Trajectory::recorded(bytes, spec)?;
        let score = match &episode.score {
            Some(scored) => {
                self.records_at(scored.place)?.into_iter().find_map(|record| match record {
                    Record::Score(score) if (score.lane, score.episode) == name => Some(score),
                    _ => None,
                })
            }
            None => None,
        };
        Ok(Recorded { trajectory, score })
    }

    fn records_at(&self, (file, offset): Place) -> Result<Vec<Record>, Error> {
        let entries = self.readers[file].1.entries_at(offset)?;
        Ok(entries.into_iter().map(|entry| entry.record).collect())
    }

    fn read_on(&mut self, file: usize) {
        loop {
            let reader = &mut self.readers[file].1;
            let Some(entry) = reader.next() else { break };
            let place = (file, reader.offset());
            let taken = match entry.map(|entry| entry.record) {
                Ok(Record::Score(score)) => {
                    self.take_score(&score, place);
                    Ok(())
                }
                Ok(record) => record.trajectory().map_or(Ok(()), |bytes| self.take(bytes, place)),
                Err(error) => Err(error.into()),
            };
            if let Err(error) = taken {
                self.keep_damage(format!("{error:#}"));
            }
        }
        let (path, reader) = &self.readers[file];
        if let Some(ending) = reader.ending().filter(|ending| ending.lost()) {
            self.keep_damage(format!("{}: {ending}", path.display()));
        }
    }

    fn take(&mut self, bytes: Bytes, place: Place) -> Result<()> {
        let found = Trajectory::decode(bytes)?;
        let episode = Episode {
            source: found.source,
            iteration: found.iteration,
            lane: found.lane,
            number: found.episode,
            policy_version: found.policy_version,
            steps: found.steps,
            ending: found.ending,
            success: found.success,
            steps_to_goal: found.steps_to_goal,
            environment_return: found.environment_return() as f32,
            trajectory: place,
            score: None,
        };
        if found.source == Source::Training as i32 {
            self.newest = found.iteration;
        }
        let next = self.listed.len();
        let at = *self.by_name.entry((found.source, found.lane, found.episode)).or_insert(next);
        if at < next {
            self.listed[at] = episode;
            (self.settled, self.generation) = (self.settled.min(at), self.generation + 1);
        } else {
            self.listed.push(episode);
        }
        Ok(())
    }

    fn take_score(&mut self, score: &Score, place: Place) {
        let name = (Source::Training as i32, score.lane, score.episode);
        let Some(&at) = self.by_name.get(&name) else { return };
        let mean = score.uncertainty.iter().sum::<f32>() / score.uncertainty.len() as f32;
        self.listed[at].score = Some(Scored {
            scored_return: score.rewards.iter().sum(),
            proximity: score.proximity.last().copied(),
            uncertainty: mean.is_finite().then_some(mean),
            place,
        });
        self.generation += u64::from(at < self.settled);
    }

    /// Finds the first episode that may still be scored: a training episode without a score, of the newest iteration
    /// or, because of `rollout.lag` 1, the one before, in a log that is being written.
    fn settle(&mut self) {
        let is_written = |(_, reader): &(_, FileReader)| reader.ending() == Some(&Ending::Unsealed);
        let is_written = self.readers.last().is_some_and(is_written);
        let may_be_scored = |episode: &Episode| {
            let is_new = episode.iteration >= self.newest.saturating_sub(1);
            let is_of_training = episode.source == Source::Training as i32;
            is_written && is_of_training && is_new && episode.score.is_none()
        };
        let unsettled = self.listed[self.settled..].iter().position(may_be_scored);
        self.settled = unsettled.map_or(self.listed.len(), |first| self.settled + first);
    }

    fn keep_damage(&mut self, line: String) {
        if self.damage.len() < DAMAGE_KEPT && !self.damage.contains(&line) {
            self.damage.push(line);
        }
    }
}

#[cfg(test)]
mod tests {
    use mcap_log::{Kind, LogOptions, LogWriter, Metadata};
    use protocol::trajectory::Encoded;

    use super::*;

    #[test]
    fn success_that_is_not_told_is_neither_true_nor_false() {
        let folder = tempfile::tempdir().unwrap();
        let metadata = Metadata::new(Kind::Run, "navigation", 1);
        let mut log = LogWriter::create(folder.path(), &metadata, LogOptions::default()).unwrap();
        for success in [false, true] {
            let (source, episode) = (Source::Evaluation as i32, u64::from(success));
            let episode = Trajectory { source, episode, success, ..Trajectory::default() };
            log.trajectory(&Encoded::encode(episode)).unwrap();
        }
        log.flush().unwrap();
        let mut episodes = Episodes::default();
        episodes.read_log(folder.path());
        let successes = |tells_success| {
            let rows = episodes.rows(0, 0, tells_success).rows;
            rows.iter().map(|row| row.7).collect::<Vec<Option<bool>>>()
        };
        assert_eq!(successes(true), [Some(false), Some(true)]);
        assert_eq!(successes(false), [None::<bool>; 2]);
    }

    #[test]
    fn rows_whose_scores_are_to_come_are_held_back() {
        let folder = tempfile::tempdir().unwrap();
        let metadata = Metadata::new(Kind::Run, "navigation", 1);
        let mut log = LogWriter::create(folder.path(), &metadata, LogOptions::default()).unwrap();
        let act = |log: &mut LogWriter, iteration| {
            let episode = Trajectory { iteration, episode: iteration, ..Trajectory::default() };
            log.trajectory(&Encoded::encode(episode)).unwrap();
        };
        let score = |log: &mut LogWriter, iteration| {
            let rewards = vec![0.5];
            let score = Score { iteration, episode: iteration, rewards, ..Score::default() };
            log.score(&score).unwrap();
        };
        let mut episodes = Episodes::default();
        let mut returns = |log: &mut LogWriter| {
            log.flush().unwrap();
            episodes.read_log(folder.path());
            let Rows { generation, rows, .. } = episodes.rows(0, 0, true);
            (generation, rows.iter().map(|row| row.9).collect::<Vec<Option<f32>>>())
        };
        // With `rollout.lag` 1, actors are ahead of the scores.
        act(&mut log, 0);
        act(&mut log, 1);
        assert_eq!(returns(&mut log), (0, vec![]));
        score(&mut log, 0);
        assert_eq!(returns(&mut log), (0, vec![Some(0.5)]));
        act(&mut log, 2);
        assert_eq!(returns(&mut log), (0, vec![Some(0.5)]));
        // A score that comes later than expected starts a new generation.
        act(&mut log, 3);
        assert_eq!(returns(&mut log), (0, vec![Some(0.5), None]));
        score(&mut log, 1);
        assert_eq!(returns(&mut log), (1, vec![Some(0.5); 2]));
        // A run that resumes from an earlier checkpoint records and scores episodes again.
        act(&mut log, 1);
        assert_eq!(returns(&mut log), (2, vec![Some(0.5)]));
        score(&mut log, 1);
        assert_eq!(returns(&mut log), (2, vec![Some(0.5); 2]));
    }
}
