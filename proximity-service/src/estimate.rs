//! Estimates of a run's trained reward model for given observations, for `goalward report` and `goalward page`
//! (Figures 4d and 10).

use anyhow::{Context, Result, ensure};
use bytes::Bytes;
use protocol::messages::Score;
use protocol::trajectory::Encoded;
use run::config::RunConfig;
use run::folder::RunFolder;
use serde::Serialize;

use crate::trained::{restored, trained_model};

/// A model's estimates, one number per observation, as printed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct PrintedEstimates {
    /// Proximity of each observation.
    pub(crate) proximity: Vec<f32>,
    /// Standard deviation of the ensemble for each observation.
    pub(crate) uncertainty: Vec<f32>,
}

/// Queries the model in a checkpoint of a run, by default the newest, about a sequence of whole observations.
///
/// # Errors
/// When there is no checkpoint, the bytes are not observations of the run's task, or the model cannot score single
/// observations.
pub(crate) fn estimate(
    folder: &RunFolder,
    checkpoint: Option<u64>,
    observations: &[u8],
) -> Result<PrintedEstimates> {
    let config = folder.config()?;
    config.task.spec().observation.check(observations)?;
    let (model, _) = restored(folder, &config, checkpoint)?;
    let estimates = model.estimate(observations)?;
    Ok(PrintedEstimates { proximity: estimates.proximity, uncertainty: estimates.uncertainty })
}

/// A model's score of an episode, as printed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct PrintedScore {
    /// Reward of each step (Eq. 5).
    pub(crate) rewards: Vec<f32>,
    /// Proximity of each observation; of each step for transitions, and for discriminators that see actions.
    pub(crate) proximity: Vec<f32>,
    /// Standard deviation of the ensemble for each proximity.
    pub(crate) uncertainty: Vec<f32>,
}

/// Scores an encoded episode of a run with the model in the newest checkpoint of the run `trained`, whose
/// configuration is `config`, possibly with other values of what scoring reads.
///
/// # Errors
/// When there is no checkpoint, the bytes are not an episode of the task, or the model sees actions and the episode has
/// none.
pub(crate) fn score(
    folder: &RunFolder,
    config: &RunConfig,
    trained: &RunFolder,
    episode: Bytes,
) -> Result<PrintedScore> {
    let spec = folder.config()?.task.spec();
    let episode = Encoded::decode(episode, &spec)?;
    ensure!(
        !config.reward.sees_actions() || !episode.trajectory.actions().is_empty(),
        "expected an episode with actions, which the model sees, found states only"
    );
    let model = trained_model(trained, config, &spec)?;
    let scores = model.score(episode.trajectory.iteration, &[episode]);
    let Score { rewards, proximity, uncertainty, .. } =
        scores.into_iter().next().context("expected a score, found none")?;
    Ok(PrintedScore { rewards, proximity, uncertainty })
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::Path;

    use mcap_log::{FileWriter, Kind, Metadata, Topic};
    use protocol::task::ObservationSpec;
    use protocol::trajectory::{Source, Trajectory};
    use run::folder::PROXIMITY_FILE;
    use run::tasks::of_text;

    use super::*;
    use crate::model;
    use crate::tests::{CORRIDOR_FILE, walk};

    const SMALL: [&str; 3] = ["demonstrations.episodes=1", "reward.batch=2", "reward.samples=4"];

    /// Returns the folder of a run of a method, with its configuration.
    fn run(home: &Path, method: &str, settings: &[&str]) -> (RunFolder, RunConfig) {
        let own = format!("method={method}");
        let settings = settings.iter().map(|&setting| setting.to_owned());
        let settings: Vec<String> = std::iter::once(own).chain(settings).collect();
        let config = of_text(CORRIDOR_FILE, "corridor", None, &settings).unwrap();
        let folder = RunFolder::new(home.join(method));
        fs::create_dir_all(folder.path()).unwrap();
        fs::write(folder.config_file(), config.to_text()).unwrap();
        (folder, config)
    }

    /// Returns the same for a run that has a demonstration and a checkpoint of its model.
    fn trained(home: &Path, method: &str) -> (RunFolder, RunConfig) {
        let (folder, config) = run(home, method, &SMALL);
        let metadata = Metadata::new(Kind::Demonstrations, "corridor", 1);
        let file = folder.demonstrations_file();
        let mut writer = FileWriter::create(&file, &metadata, &[Topic::Trajectory]).unwrap();
        writer.trajectory(&Encoded::encode(episode(Source::Demonstration)), 0).unwrap();
        writer.seal().unwrap();
        let checkpoint = folder.checkpoint_folder(1);
        fs::create_dir_all(&checkpoint).unwrap();
        let model = model::of_run(&folder, &config).unwrap();
        model.save().save(&checkpoint.join(PROXIMITY_FILE)).unwrap();
        (folder, config)
    }

    fn episode(source: Source) -> Trajectory {
        Trajectory { task: "corridor".to_owned(), ..walk(0.0, source) }
    }

    fn bytes() -> Bytes {
        Encoded::encode(episode(Source::Training)).bytes
    }

    #[test]
    fn a_trained_model_needs_nothing_of_the_run_whose_episode_it_scores() {
        let home = tempfile::tempdir().unwrap();
        let (own, _) = run(home.path(), "environment-reward", &[]);
        for method in ["goal-proximity", "gail"] {
            let (other, config) = trained(home.path(), method);
            let found = score(&own, &config, &other, bytes()).unwrap();
            assert_eq!(found, score(&other, &config, &other, bytes()).unwrap(), "{method}");
            assert_eq!(found.rewards.len(), 10);
        }
    }

    #[test]
    fn a_model_that_learns_nothing_takes_the_place_of_the_trained_one() {
        let home = tempfile::tempdir().unwrap();
        let (folder, config) = trained(home.path(), "goal-proximity");
        let scored = |settings: &[&str]| {
            let settings: Vec<String> = settings.iter().map(|&one| one.to_owned()).collect();
            score(&folder, &config.for_scoring(&settings).unwrap(), &folder, bytes()).unwrap()
        };
        let nearest = scored(&["reward.model=nearest-state", "reward.segments=5"]);
        assert_eq!((nearest.rewards, nearest.proximity), (vec![0.0; 10], vec![1.0; 11]));
        let environment = scored(&["reward.model=environment"]);
        assert_eq!((environment.rewards.len(), environment.proximity.len()), (10, 0));
        let (own, config) = run(home.path(), "environment-reward", &[]);
        assert_eq!(score(&own, &config, &own, bytes()).unwrap(), environment, "no checkpoint");
    }

    #[test]
    fn an_episode_without_what_the_model_sees_is_refused() {
        let home = tempfile::tempdir().unwrap();
        let (folder, mut config) = trained(home.path(), "gail");
        let shown = Trajectory { discrete_actions: Bytes::new(), ..episode(Source::Demonstration) };
        let shown = Encoded::encode(shown).bytes;
        let said = score(&folder, &config, &folder, shown).unwrap_err().to_string();
        assert!(said.contains("found states only"), "{said}");
        config.task.observation = ObservationSpec::Vector { len: 3 };
        let said = score(&folder, &config, &folder, bytes()).unwrap_err().to_string();
        assert!(said.contains("expected a model of Vector { len: 2 }"), "{said}");
    }
}
