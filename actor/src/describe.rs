//! `goalward-actor describe`: describes a task, and completes settings with the environment's defaults.

use anyhow::Result;
use environments::{Environment, EnvironmentError, Expert, Setting};
use protocol::description::Description;
use protocol::task::Task;

use crate::factory::{Factory, Tasks};
use crate::python;

/// Describes a task, in the setting of an agent and in the setting that its demonstrations are recorded in.
///
/// # Errors
/// When the program does not have the task, or the task does not have such a setting; the message names the
/// part of the configuration.
pub(crate) fn describe(
    tasks: Tasks,
    name: &str,
    environment: Setting,
    demonstrations: Setting,
) -> Result<Description> {
    let (environment, deterministic) = python::purified(environment)?;
    let factory = Factory::new(tasks, name, environment)?;
    let agents = make(&factory, "environment")?;
    let recorded_in = Factory::new(tasks, name, demonstrations)?;
    let experts = make(&recorded_in, "demonstrations")?;
    Ok(Description {
        task: Task { deterministic, ..factory.described(&*agents) },
        environment: agents.setting(),
        demonstrations: experts.setting(),
        has_expert: !matches!(recorded_in.task.expert, Expert::None),
    })
}

fn make(factory: &Factory, part: &str) -> Result<Box<dyn Environment>> {
    factory.make().map_err(|error| match error.downcast::<EnvironmentError>() {
        Ok(EnvironmentError::Setting(error)) => error.of_part(part).into(),
        Ok(error) => anyhow::Error::from(error).context(format!("`{part}`")),
        Err(error) => error,
    })
}

#[cfg(test)]
mod tests {
    use environments::BUILT_IN;

    use super::*;

    fn setting(text: &str) -> Setting {
        Setting(text.parse().expect("a table"))
    }

    #[test]
    fn settings_come_back_complete() {
        let found = describe(BUILT_IN, "fetch-push", setting("noise = 2"), setting("noise = 1"));
        let found = found.expect("a description");
        let complete = |noise| {
            setting(&format!(
                "coverage = 1.0\nnoise = {noise}\nranges = \"symmetric\"\naction_scale = []\nend_at_goal = true"
            ))
        };
        assert_eq!(found.environment, complete("2.0"));
        assert_eq!(found.demonstrations, complete("1.0"));
        assert_eq!((found.task.name.as_str(), found.task.horizon_steps), ("fetch-push", 60));
        assert!(found.has_expert);
    }

    /// Otherwise a run's own configuration, which is complete, would differ from its task's.
    #[test]
    fn the_files_of_tasks_name_every_key_of_their_environments() {
        for task in run::tasks::names() {
            let config = run::tasks::configuration(task, None, &[]).expect("a configuration");
            let (agents, experts) = (config.environment.clone(), config.demonstration_setting());
            let found = describe(BUILT_IN, task, agents, experts).expect("a description");
            assert_eq!(found.environment, config.environment, "{task}");
        }
    }

    #[test]
    fn a_refusal_names_the_part_and_the_key() {
        let refusal = |environment, demonstrations| {
            let [one, other] = [environment, demonstrations].map(setting);
            describe(BUILT_IN, "fetch-push", one, other).expect_err("a refusal").to_string()
        };
        assert!(refusal("noise = 9", "").contains("`environment.noise` must be 0 to 3"));
        assert!(refusal("", "coverage = 0.3").contains("`demonstrations.coverage`"));
        let unknown = refusal("", "wind = 3");
        assert!(unknown.contains("`demonstrations`") && unknown.contains("`wind`"), "{unknown}");
    }
}
