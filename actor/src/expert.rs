//! Experts that demonstrate a task: the script of its environment, or a trained policy, the task's own or that of a
//! run.

use anyhow::{Context, Result, bail, ensure};
use environments::{Expert, Setting};
use protocol::setting::ACTION_SCALE;
use protocol::weights::Weights;
use run::checkpoint;
use run::config::RunConfig;
use run::folder::{POLICY_FILE, RunFolder};

use crate::factory::Factory;
use crate::policy::{Policy, Version};

/// An expert that demonstrates a task.
pub enum ActingExpert {
    /// The script of the task's environment.
    Script,
    /// A policy, which takes its most probable actions.
    Policy(Box<TrainedExpert>),
}

/// A policy that demonstrates.
pub struct TrainedExpert {
    /// The policy.
    pub policy: Policy,
    /// Its weights.
    pub version: Version,
    /// The setting that it was trained in.
    trained_in: Setting,
    /// Whether it comes with its task.
    is_of_task: bool,
}

impl ActingExpert {
    /// Returns the expert that comes with a task.
    ///
    /// # Errors
    /// When there is none.
    pub fn of_task(factory: &Factory) -> Result<ActingExpert> {
        let name = &factory.name;
        match factory.task.expert {
            Expert::None => bail!(
                "{name}: expected a task that has an expert, found one without; give \
                 --demonstrations FILE.mcap, or an expert with --policy RUN"
            ),
            Expert::Scripted => Ok(ActingExpert::Script),
            Expert::Policy { config, weights } => {
                let config = RunConfig::from_text(config, "of the expert")?;
                let weights = Weights::from_file(weights).map_err(anyhow::Error::msg)?;
                ActingExpert::trained(&config, &weights, true).context(name.clone())
            }
        }
    }

    /// Returns the policy of a run's newest checkpoint as an expert.
    ///
    /// # Errors
    /// When the run is of another task, or has no intact checkpoint.
    pub fn of_run(folder: &RunFolder, task: &str) -> Result<ActingExpert> {
        let config = folder.config()?;
        let (shown, found) = (folder.path().display(), &config.task.name);
        ensure!(found == task, "{shown}: expected a run of {task}, found one of {found}");
        let weights = checkpoint::chosen(folder, None, &[POLICY_FILE])?.policy()?;
        ActingExpert::trained(&config, &weights, false)
    }

    fn trained(config: &RunConfig, weights: &Weights, is_of_task: bool) -> Result<ActingExpert> {
        let policy = Policy::new(config);
        let version = policy.version(weights)?;
        let trained_in = config.environment.clone();
        Ok(ActingExpert::Policy(Box::new(TrainedExpert {
            policy,
            version,
            trained_in,
            is_of_task,
        })))
    }

    /// Returns whether the expert comes with its task.
    pub fn is_of_task(&self) -> bool {
        match self {
            ActingExpert::Script => true,
            ActingExpert::Policy(expert) => expert.is_of_task,
        }
    }

    /// Returns the setting to record in so that demonstrations are as `wanted`, which must be complete: a
    /// policy's actions keep the scale that they were trained with.
    ///
    /// # Errors
    /// When a policy would have to act on observations that it was not trained on: `observed` lists the keys
    /// that change the meaning of observations.
    pub fn setting(&self, wanted: &Setting, observed: &[&str]) -> Result<Setting> {
        let ActingExpert::Policy(expert) = self else { return Ok(wanted.clone()) };
        let trained_in = &expert.trained_in.0;
        for &key in observed {
            if let (Some(expected), Some(found)) = (trained_in.get(key), wanted.0.get(key)) {
                ensure!(
                    expected == found,
                    "environment.{key}: expected {expected}, as the expert was trained with, \
                     found {found}; --policy names a run of another expert"
                );
            }
        }
        let mut setting = wanted.clone();
        if let Some(scale) = trained_in.get(ACTION_SCALE) {
            setting.0.insert(ACTION_SCALE.to_owned(), scale.clone());
        }
        Ok(setting)
    }
}

#[cfg(test)]
mod tests {
    use environments::BUILT_IN;
    use run::process::Stop;

    use super::*;
    use crate::demonstrate::{Request, demonstrate};

    fn ant_reach(setting: &str) -> Factory {
        let setting = Setting(setting.parse().expect("a table"));
        Factory::new(BUILT_IN, "ant-reach", setting).expect("the task")
    }

    #[test]
    fn the_expert_of_ant_reach_reaches_its_goals_whatever_the_scale_of_actions() {
        let folder = tempfile::tempdir().expect("a folder");
        for (number, setting) in
            ["", "action_scale = [0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5]"].into_iter().enumerate()
        {
            let request = Request {
                factory: ant_reach(setting),
                episodes: 20,
                seed: 7,
                file: &folder.path().join(format!("{number}.mcap")),
                force: false,
            };
            let expert = ActingExpert::of_task(&request.factory).expect("the expert");
            let recorded = demonstrate(&request, expert, &Stop::default()).expect("demonstrations");
            assert!(recorded.failures.is_some_and(|failures| failures <= 2), "{recorded:?}");
            assert!(recorded.steps < 20 * 30, "{} steps in 20 episodes", recorded.steps);
        }
    }

    #[test]
    fn an_expert_is_not_asked_for_what_it_never_saw() {
        let feeling = ant_reach("contact_forces = true");
        let expert = ActingExpert::of_task(&feeling).expect("the expert");
        let wanted = feeling.make().expect("the environment").setting();
        let refusal = expert.setting(&wanted, feeling.task.observed).expect_err("forces");
        let refusal = refusal.to_string();
        assert!(refusal.contains("contact_forces: expected false"), "{refusal}");
    }
}
