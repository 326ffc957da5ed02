//! Another reward for the recorded episodes of a run: changes to the configuration of its reward, or the trained model
//! of another run.

use anyhow::Result;
use run::config::RunConfig;
use run::folder::RunFolder;
use terminal::refusal::wrong_usage;

use crate::prepared_run;

/// Prefix of a change that names a run whose trained model scores.
const MODEL: &str = "model=";

/// A reward that the run was not trained with.
pub(crate) struct OtherReward {
    /// The configuration with this reward: that of the run whose trained model scores, else the run's own.
    pub(crate) config: RunConfig,
    /// Run whose trained model scores; if `None`, a model is trained as the run's own was.
    pub(crate) model: Option<RunFolder>,
}

impl OtherReward {
    /// Returns the reward that results from `changes`, each `key=value`, where the key is of the reward or `model`.
    /// With a trained model, only what scoring reads can be changed, and nothing is asked of the run's own reward.
    ///
    /// # Errors
    /// Wrong usage, when a key is another one, or several models are named; when the reward is not valid.
    pub(crate) fn of(folder: &RunFolder, changes: &[String]) -> Result<OtherReward> {
        let (models, settings): (Vec<_>, Vec<_>) =
            changes.iter().partition(|change| change.starts_with(MODEL));
        let own = folder.config()?;
        let settings: Vec<String> = settings.into_iter().cloned().collect();
        if let Some(other) = settings.iter().find(|setting| !setting.starts_with("reward.")) {
            return Err(wrong_usage(format!(
                "--with {other}: expected a key such as reward.uncertainty, or model=RUN"
            )));
        }
        match models[..] {
            [] => Ok(OtherReward { config: prepared_run::changed(&own, &settings)?, model: None }),
            [one] => {
                let model = RunFolder::new(&one[MODEL.len()..]);
                let config = model.config()?.for_scoring(&settings)?;
                Ok(OtherReward { config, model: Some(model) })
            }
            _ => Err(wrong_usage("expected one model=RUN, found several")),
        }
    }
}
