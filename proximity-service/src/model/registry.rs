//! The constructor of each reward model, by its name in a configuration.

use anyhow::{Context, Result};
use run::config::RunConfig;
use run::folder::RunFolder;

use super::{
    Discriminator, FixedReward, GoalProximity, Learned, NearestState, Objective,
    ProximityDiscriminator, Ranking, RewardModel, TemporalDistance,
};

type Constructor = fn(&RunFolder, &RunConfig) -> Result<Box<dyn RewardModel>>;

/// Constructors in the order of [`run::config::REWARD_MODELS`].
const MODELS: &[(&str, Constructor)] = &[
    ("proximity", learned::<GoalProximity>),
    ("proximity-discriminator", ProximityDiscriminator::of_run),
    ("ranking", learned::<Ranking>),
    ("discriminator", learned::<Discriminator>),
    ("temporal-distance", learned::<TemporalDistance>),
    ("nearest-state", NearestState::of_run),
    ("environment", |_, _| Ok(Box::new(FixedReward::Environment))),
    ("none", |_, _| Ok(Box::new(FixedReward::None))),
];

/// Creates the untrained reward model of a run.
///
/// # Errors
/// When its demonstrations cannot be read.
pub fn of_run(folder: &RunFolder, config: &RunConfig) -> Result<Box<dyn RewardModel>> {
    let name = config.reward.model.name;
    let found = MODELS.iter().find(|(known, _)| *known == name);
    let (_, construct) =
        found.with_context(|| format!("expected the name of a reward model, found {name}"))?;
    construct(folder, config)
}

fn learned<O: Objective + 'static>(
    folder: &RunFolder,
    config: &RunConfig,
) -> Result<Box<dyn RewardModel>> {
    let demonstrations = run::origin::load_demonstrations(folder, config)?;
    Ok(Box::new(Learned::<O>::of_run(config, &demonstrations)?))
}

#[cfg(test)]
mod tests {
    use run::config::REWARD_MODELS;

    use super::*;

    #[test]
    fn the_tables_name_the_same_models() {
        let names = MODELS.iter().map(|(name, _)| *name);
        assert!(names.eq(REWARD_MODELS.iter().map(|model| model.name)));
    }
}
