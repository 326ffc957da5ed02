//! Episodes as a browser shows them: what happened, what the reward model said or says, the scene.

use anyhow::{Context, Result};
use bytes::Bytes;
use mcap_log::{FileReader, Record};
use protocol::scene::{FRAME_NS, SceneUpdate};
use protocol::task::{ActionSpec, ObservationSpec, Task, floats};
use protocol::trajectory::Trajectory;
use report::grid::{Classes, Everywhere};
use report::programs::Estimates;
use run::config::RunConfig;
use run::folder::RunFolder;
use serde::Serialize;

use crate::collections::{Collections, locked};
use crate::episodes::Recorded;
use crate::programs::{Processes, Programs, Score};
use crate::scenes::Scenes;

/// Episodes as they are shown.
pub(crate) struct Shown {
    collections: Collections,
    programs: Box<dyn Programs>,
}

/// An episode that a browser asks for.
pub(crate) struct Asked {
    folder: RunFolder,
    config: RunConfig,
    setting: Option<String>,
    recorded: Recorded,
    /// Its scenes, where it has been acted again already.
    scenes: Option<Vec<SceneUpdate>>,
}

impl Shown {
    /// Before the first question.
    pub(crate) fn new(programs: Box<dyn Programs>) -> Shown {
        Shown { collections: Collections::default(), programs }
    }

    /// The rows of a collection as JSON; none where there is no such collection.
    ///
    /// # Errors
    /// When the run's configuration cannot be read.
    pub(crate) fn rows(
        &self,
        folder: &RunFolder,
        collection: &str,
        generation: u64,
        from: usize,
    ) -> Result<Option<String>> {
        let Some(episodes) = self.collections.get(folder, &folder.config()?, collection) else {
            return Ok(None);
        };
        let episodes = locked(&episodes);
        Ok(Some(serde_json::to_string(&episodes.rows(generation, from))?))
    }

    /// An episode of a collection; none where there is no such row.
    ///
    /// # Errors
    /// When it cannot be read.
    pub(crate) fn asked(
        &self,
        folder: &RunFolder,
        collection: &str,
        row: usize,
    ) -> Result<Option<Asked>> {
        let config = folder.config()?;
        let Some(episodes) = self.collections.get(folder, &config, collection) else {
            return Ok(None);
        };
        let episodes = locked(&episodes);
        let setting = episodes.setting();
        let Some(recorded) = episodes.recorded(row, &config.task.spec()) else { return Ok(None) };
        let (folder, recorded) = (folder.clone(), recorded?);
        let mut asked = Asked { folder, config, setting, recorded, scenes: None };
        drop(episodes);
        if asked.recorded.trajectory.is_actions_only() {
            let Drawn { trajectory, scenes, .. } = self.drawn(&asked, false)?;
            (asked.recorded.trajectory, asked.scenes) = (trajectory, Some(scenes));
        }
        Ok(Some(asked))
    }

    /// The solids of an episode where they were; none where its task has no solids.
    ///
    /// # Errors
    /// When it does not act again as it was recorded.
    pub(crate) fn scenes(&self, asked: &Asked) -> Result<Option<Scenes>> {
        Ok(match &asked.scenes {
            Some(scenes) => Scenes::of(scenes),
            None => Scenes::of(&self.drawn(asked, false)?.scenes),
        })
    }

    /// Pictures that the environment renders of an episode: behind one another the number of the state, the
    /// length of the file and the PNG file, numbers as four bytes, the lowest first.
    ///
    /// # Errors
    /// When it does not act again as it was recorded, or cannot render.
    pub(crate) fn pictures(&self, asked: &Asked) -> Result<Vec<u8>> {
        let mut bytes = Vec::new();
        for (state, picture) in self.drawn(asked, true)?.pictures {
            for number in [state, u32::try_from(picture.len())?] {
                bytes.extend(number.to_le_bytes());
            }
            bytes.extend(picture);
        }
        Ok(bytes)
    }

    /// What a run's reward model says of an episode's observations now.
    ///
    /// # Errors
    /// When it cannot tell single observations.
    pub(crate) fn proximity(&self, asked: &Asked, checkpoint: Option<u64>) -> Result<Estimates> {
        let observations = asked.recorded.trajectory.observations();
        self.programs.estimate(&asked.folder, checkpoint, observations)
    }

    /// What a run's reward model says of the agent on every free cell of an episode's grid (Figure 4d).
    ///
    /// # Errors
    /// When the task is no such grid, or the model cannot tell single observations.
    pub(crate) fn grid(&self, asked: &Asked, checkpoint: Option<u64>) -> Result<Grid> {
        let Asked { folder, config, recorded, .. } = asked;
        let classes = Classes::of(&config.task).context("expected a grid with walls and a goal")?;
        let one = config.task.observation.bytes();
        let everywhere = Everywhere::of(&recorded.trajectory.observations()[..one], &classes);
        let estimates = self.programs.estimate(folder, checkpoint, &everywhere.observations())?;
        Ok(Grid { places: everywhere.places().to_vec(), estimates })
    }

    /// What an episode would have earned from another reward.
    ///
    /// # Errors
    /// When there is no such reward.
    pub(crate) fn score(&self, asked: &Asked, changes: &[String]) -> Result<Score> {
        self.programs.score(&asked.folder, changes, &asked.recorded.trajectory)
    }

    /// The processes of a run; none where nobody trains it.
    ///
    /// # Errors
    /// When its bus cannot be listed.
    pub(crate) fn processes(&self, folder: &RunFolder) -> Result<Option<Processes>> {
        self.programs.processes(folder)
    }

    /// An episode acted again, with pictures if its environment can render them.
    fn drawn(&self, asked: &Asked, pictures: bool) -> Result<Drawn> {
        let Asked { folder, config, setting, recorded, .. } = asked;
        let place = tempfile::tempdir()?;
        let file = place.path().join("episode.mcap");
        self.programs.draw(folder, setting.as_deref(), &recorded.trajectory, pictures, &file)?;
        let (mut trajectory, mut scenes, mut pictures) = (None, Vec::new(), Vec::new());
        for entry in FileReader::open(&file)? {
            let entry = entry?;
            match entry.record {
                Record::Scene(scene) => scenes.push(scene),
                Record::Picture(picture) => {
                    let state = u32::try_from(entry.log_time_ns / FRAME_NS)?;
                    pictures.push((state, picture.data));
                }
                record => trajectory = trajectory.or(record.trajectory()),
            }
        }
        let bytes = trajectory.context("expected an episode that acts again, found none")?;
        let trajectory = Trajectory::recorded(bytes, &config.task.spec())?;
        Ok(Drawn { trajectory, scenes, pictures })
    }
}

/// An episode that was acted again.
struct Drawn {
    trajectory: Trajectory,
    scenes: Vec<SceneUpdate>,
    /// By the number of the state.
    pictures: Vec<(u32, Bytes)>,
}

/// Estimates at places of a grid, each by its number in an observation.
#[derive(Debug, Serialize)]
pub(crate) struct Grid {
    places: Vec<usize>,
    #[serde(flatten)]
    estimates: Estimates,
}

/// An episode as a browser gets it.
#[derive(Debug, Serialize)]
pub(crate) struct Episode<'a> {
    task: &'a Task,
    iteration: u64,
    lane: u64,
    episode: u64,
    policy_version: u64,
    steps: u32,
    ending: i32,
    success: bool,
    steps_to_goal: u32,
    /// Of a grid: a class for each cell, observation after observation.
    cells: &'a [u8],
    /// Of a vector: its numbers, observation after observation.
    values: Vec<f32>,
    actions: Vec<f32>,
    environment_rewards: Vec<f32>,
    /// What the reward model said when the policy learned from it; empty where it said nothing.
    rewards: &'a [f32],
    proximity: &'a [f32],
    uncertainty: &'a [f32],
}

impl Asked {
    /// As a browser gets it.
    pub(crate) fn episode(&self) -> Episode<'_> {
        let Recorded { trajectory, score } = &self.recorded;
        let task = &self.config.task;
        let (cells, values) = match task.observation {
            ObservationSpec::Cells { .. } => (trajectory.observations(), Vec::new()),
            ObservationSpec::Vector { .. } => {
                (&[][..], floats(trajectory.observations()).collect())
            }
        };
        let actions = match task.action {
            ActionSpec::Discrete { .. } => {
                trajectory.actions().iter().map(|&action| f32::from(action)).collect()
            }
            ActionSpec::Continuous { .. } => floats(trajectory.actions()).collect(),
        };
        Episode {
            task,
            iteration: trajectory.iteration,
            lane: trajectory.lane,
            episode: trajectory.episode,
            policy_version: trajectory.policy_version,
            steps: trajectory.steps,
            ending: trajectory.ending,
            success: trajectory.success,
            steps_to_goal: trajectory.steps_to_goal,
            cells,
            values,
            actions,
            environment_rewards: floats(&trajectory.environment_rewards).collect(),
            rewards: score.as_ref().map_or(&[], |score| &score.rewards),
            proximity: score.as_ref().map_or(&[], |score| &score.proximity),
            uncertainty: score.as_ref().map_or(&[], |score| &score.uncertainty),
        }
    }
}
