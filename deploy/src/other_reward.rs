//! Another reward for what a run has recorded: changes to the configuration of its reward, or the trained model of
//! another run.

use anyhow::Result;
use run::config::RunConfig;
use run::folder::RunFolder;
use terminal::refusal::wrong_usage;

use crate::plan;

/// What a change begins with that names a run whose trained model scores.
const MODEL: &str = "model=";

/// A reward that a run was not trained by.
pub(crate) struct OtherReward {
    /// The run's configuration with it.
    pub(crate) config: RunConfig,
    /// The run whose trained model scores; none for one that is trained as the run's own was.
    pub(crate) model: Option<RunFolder>,
}

impl OtherReward {
    /// That of `changes`, each `key=value`, where the key is of the reward or `model`.
    ///
    /// # Errors
    /// Of wrong usage when a change is not of the reward.
    pub(crate) fn of(folder: &RunFolder, changes: &[String]) -> Result<OtherReward> {
        let (models, settings): (Vec<_>, Vec<_>) =
            changes.iter().partition(|change| change.starts_with(MODEL));
        let model = match models[..] {
            [] => None,
            [one] => Some(RunFolder::new(&one[MODEL.len()..])),
            _ => return Err(wrong_usage("expected one model=RUN, found several")),
        };
        let mut config = folder.config()?;
        if let Some(model) = &model {
            config.reward = model.config()?.reward;
        }
        let settings: Vec<String> = settings.into_iter().cloned().collect();
        if let Some(other) = settings.iter().find(|setting| !setting.starts_with("reward.")) {
            return Err(wrong_usage(format!(
                "--with {other}: expected a key such as reward.uncertainty, or model=RUN"
            )));
        }
        Ok(OtherReward { config: plan::changed(&config, &settings)?, model })
    }
}
