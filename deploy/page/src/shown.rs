//! Single episodes for the browser: the record, recorded and new scores by reward models, the scene.

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
use crate::programs::{PagePrograms, Processes, Score};
use crate::scenes::Scenes;

/// What serves requests about episodes and processes: the collections and the programs.
pub(crate) struct Shown {
    collections: Collections,
    programs: Box<dyn PagePrograms>,
}

/// An episode that a browser requests.
pub(crate) struct Asked {
    folder: RunFolder,
    config: RunConfig,
    setting: Option<String>,
    recorded: Recorded,
    /// Its scenes, if it has already been re-simulated.
    scenes: Option<Vec<SceneUpdate>>,
}

impl Shown {
    /// Creates it with nothing read yet.
    pub(crate) fn new(programs: Box<dyn PagePrograms>) -> Shown {
        Shown { collections: Collections::default(), programs }
    }

    /// Returns the rows of a collection as JSON; `None` if there is no such collection.
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
        let config = folder.config()?;
        let Some(episodes) = self.collections.get(folder, &config, collection) else {
            return Ok(None);
        };
        let episodes = locked(&episodes);
        let rows = episodes.rows(generation, from, config.task.tells_success);
        Ok(Some(serde_json::to_string(&rows)?))
    }

    /// Returns an episode of a collection, re-simulated if its observations were not recorded; `None` if there is no
    /// such row.
    ///
    /// # Errors
    /// When it cannot be read or re-simulated.
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

    /// Returns the solids of an episode and their poses; `None` if the task has no solids.
    ///
    /// # Errors
    /// When re-simulation does not reproduce the recorded episode.
    pub(crate) fn scenes(&self, asked: &Asked) -> Result<Option<Scenes>> {
        Ok(match &asked.scenes {
            Some(scenes) => Scenes::of(scenes),
            None => Scenes::of(&self.drawn(asked, false)?.scenes),
        })
    }

    /// Returns the pictures that the environment renders of an episode, one after another: the number of the state and
    /// the length of the file, each as four bytes in little-endian order, then the PNG file. Returns nothing if the
    /// environment renders no pictures.
    ///
    /// # Errors
    /// When re-simulation does not reproduce the recorded episode, or rendering fails.
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

    /// Returns the estimates of a run's reward model in a checkpoint, by default the newest, for an episode's
    /// observations.
    ///
    /// # Errors
    /// When there is no such checkpoint, or the model cannot score single observations.
    pub(crate) fn proximity(&self, asked: &Asked, checkpoint: Option<u64>) -> Result<Estimates> {
        let observations = asked.recorded.trajectory.observations();
        self.programs.estimate(&asked.folder, checkpoint, observations)
    }

    /// Returns the estimates of a run's reward model with the agent on every free cell of an episode's grid
    /// (Figure 4d).
    ///
    /// # Errors
    /// When the task is not such a grid, there is no such checkpoint, or the model cannot score single observations.
    pub(crate) fn grid(&self, asked: &Asked, checkpoint: Option<u64>) -> Result<Grid> {
        let Asked { folder, config, recorded, .. } = asked;
        let classes = Classes::of(&config.task).context("expected a grid with walls and a goal")?;
        let one = config.task.observation.bytes();
        let everywhere = Everywhere::of(&recorded.trajectory.observations()[..one], &classes);
        let estimates = self.programs.estimate(folder, checkpoint, &everywhere.observations())?;
        Ok(Grid { places: everywhere.places().to_vec(), estimates })
    }

    /// Scores an episode under another reward, with the trained model of the run `model`, or of its own.
    ///
    /// # Errors
    /// When a change is not to what scoring reads of the reward, or there is no such model.
    pub(crate) fn score(
        &self,
        asked: &Asked,
        model: Option<&RunFolder>,
        mut changes: Vec<String>,
    ) -> Result<Score> {
        let model = model.unwrap_or(&asked.folder);
        changes.push(format!("model={}", model.path().display()));
        self.programs.score(&asked.folder, &changes, &asked.recorded.trajectory)
    }

    /// Returns the processes of a run; `None` if it is not being trained.
    ///
    /// # Errors
    /// When the processes on its bus cannot be listed.
    pub(crate) fn processes(&self, folder: &RunFolder) -> Result<Option<Processes>> {
        self.programs.processes(folder)
    }

    /// Re-simulates an episode, with `pictures` if its environment can render them.
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
        let bytes =
            trajectory.context("expected an episode that can be re-simulated, found none")?;
        let trajectory = Trajectory::recorded(bytes, &config.task.spec())?;
        Ok(Drawn { trajectory, scenes, pictures })
    }
}

/// A re-simulated episode.
struct Drawn {
    trajectory: Trajectory,
    scenes: Vec<SceneUpdate>,
    /// PNG files, each with the number of its state.
    pictures: Vec<(u32, Bytes)>,
}

/// Estimates with the agent on cells of a grid, each cell given by its index in an observation.
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
    /// `None` if the task does not tell success.
    success: Option<bool>,
    steps_to_goal: u32,
    /// For a grid: the class of each cell, observation after observation.
    cells: &'a [u8],
    /// For a vector: its numbers, observation after observation.
    values: Vec<f32>,
    actions: Vec<f32>,
    environment_rewards: Vec<f32>,
    /// Rewards that the policy learned from; like the next two, empty if the episode was not scored.
    rewards: &'a [f32],
    proximity: &'a [f32],
    uncertainty: &'a [f32],
}

impl Asked {
    /// Returns whether its run has a checkpoint after this number of iterations.
    pub(crate) fn has_checkpoint(&self, iteration: u64) -> bool {
        self.folder.checkpoint_folder(iteration).is_dir()
    }

    /// Returns the episode as a browser gets it.
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
            success: task.tells_success.then_some(trajectory.success),
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
