//! Who demonstrates a task: the script of its environment, or a policy that was trained on the
//! environment's own reward.

use anyhow::{Context, Result, ensure};
use environments::Setting;
use protocol::task::Task;
use protocol::weights::Weights;
use run::config::RunConfig;
use run::folder::RunFolder;

use crate::policy::{Policy, Version, newest_weights};

/// Who demonstrates a task.
pub enum Expert {
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
    /// What it was trained in.
    trained_in: Setting,
    /// Whether it comes with its task.
    is_of_task: bool,
}

impl Expert {
    /// The expert that comes with a task. That of Ant Reach is a policy; `actor/experts/README.md`
    /// has the command it was trained with.
    pub fn of_task(task: Task) -> Result<Expert> {
        if task != Task::AntReach {
            return Ok(Expert::Script);
        }
        let config = include_str!("../experts/ant_reach/config.toml");
        let weights = include_bytes!("../experts/ant_reach/policy.safetensors");
        let origin = "actor/experts/ant_reach";
        let config = RunConfig::from_text(config, origin)?;
        let weights = Weights::from_file(weights).map_err(anyhow::Error::msg)?;
        Expert::trained(&config, &weights, true).context(origin)
    }

    /// The policy of the newest checkpoint of a run.
    pub fn of_run(folder: &RunFolder, task: Task) -> Result<Expert> {
        let config = folder.config()?;
        let (shown, found) = (folder.path().display(), config.task);
        ensure!(found == task, "{shown}: expected a run of {task}, found one of {found}");
        Expert::trained(&config, &newest_weights(folder)?, false)
    }

    fn trained(config: &RunConfig, weights: &Weights, is_of_task: bool) -> Result<Expert> {
        let policy = Policy::new(config);
        let version = policy.version(weights)?;
        let trained_in = config.environment.clone();
        Ok(Expert::Policy(Box::new(TrainedExpert { policy, version, trained_in, is_of_task })))
    }

    /// Whether it is the one that comes with its task.
    pub fn is_of_task(&self) -> bool {
        match self {
            Expert::Script => true,
            Expert::Policy(expert) => expert.is_of_task,
        }
    }

    /// The setting to demonstrate in so that demonstrations are as `wanted`: a policy's actions
    /// keep the scale they were trained with.
    pub fn setting(&self, wanted: &Setting) -> Result<Setting> {
        let Expert::Policy(expert) = self else { return Ok(wanted.clone()) };
        let forces = |setting: &Setting| setting.contact_forces.unwrap_or(false);
        let (expected, found) = (forces(&expert.trained_in), forces(wanted));
        ensure!(
            expected == found,
            "environment.contact_forces: expected {expected}, as the expert was trained with, \
             found {found}; --policy names a run of another expert"
        );
        Ok(Setting { action_scale: expert.trained_in.action_scale.clone(), ..wanted.clone() })
    }
}

#[cfg(test)]
mod tests {
    use run::process::Stop;

    use super::*;
    use crate::demonstrate::{Request, demonstrate};

    #[test]
    fn the_expert_of_ant_reach_reaches_its_goals_whatever_the_scale_of_actions() {
        let folder = tempfile::tempdir().expect("a folder");
        for (number, action_scale) in [vec![], vec![0.4; 8]].into_iter().enumerate() {
            let request = Request {
                task: Task::AntReach,
                episodes: 20,
                setting: Setting { noise: Some(0.0), action_scale, ..Setting::default() },
                seed: 7,
                file: &folder.path().join(format!("{number}.mcap")),
            };
            let expert = Expert::of_task(request.task).expect("the expert");
            let recorded = demonstrate(&request, expert, &Stop::default()).expect("demonstrations");
            assert!(recorded.failures <= 2, "{} failures beside 20", recorded.failures);
            assert!(recorded.steps < 20 * 30, "{} steps in 20 episodes", recorded.steps);
        }
    }

    #[test]
    fn an_expert_is_not_asked_for_what_it_never_saw() {
        let expert = Expert::of_task(Task::AntReach).expect("the expert");
        let wanted = Setting { contact_forces: Some(true), ..Setting::default() };
        let refusal = expert.setting(&wanted).expect_err("forces").to_string();
        assert!(refusal.contains("contact_forces: expected false"), "{refusal}");
    }
}
