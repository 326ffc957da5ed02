//! The configuration files of tasks and methods, carried within the program.

use protocol::Error;
use protocol::task::Task;
use run::config::RunConfig;

/// The text of `deploy/methods.toml`.
const METHODS: &str = include_str!("../methods.toml");

/// The effective configuration of a task under a preset, with `key=value` settings; the method is
/// one of them.
pub(crate) fn configuration(
    task: Task,
    preset: &str,
    settings: &[String],
) -> Result<RunConfig, Error> {
    RunConfig::assemble(file_of(task), METHODS, preset, settings)
}

/// The text of `deploy/tasks/TASK.toml`.
fn file_of(task: Task) -> &'static str {
    match task {
        Task::Navigation => include_str!("../tasks/navigation.toml"),
        Task::FetchPick => include_str!("../tasks/fetch_pick.toml"),
        Task::FetchPush => include_str!("../tasks/fetch_push.toml"),
        Task::AntReach => include_str!("../tasks/ant_reach.toml"),
    }
}

#[cfg(test)]
mod tests {
    use toml::Table;

    use super::*;

    #[test]
    fn every_preset_of_every_task_is_a_whole_configuration() {
        for task in Task::ALL {
            for preset in ["goalward", "paper", "authors"] {
                let config = configuration(task, preset, &[]).unwrap();
                assert_eq!((config.task, config.preset.as_str()), (task, preset));
            }
        }
    }

    #[test]
    fn every_method_is_a_whole_configuration_of_every_task() {
        let methods = METHODS.parse::<Table>().unwrap();
        assert!(methods.len() > 15, "{methods:?}");
        for (task, method) in
            Task::ALL.into_iter().flat_map(|task| methods.keys().map(move |method| (task, method)))
        {
            for preset in ["goalward", "paper", "authors"] {
                let config = configuration(task, preset, &[format!("method={method}")]).unwrap();
                assert_eq!(config.method, *method);
            }
        }
        let scaled =
            ["method=sqil", "environment.action_scale=[0.1, 0.6, 0.15]"].map(str::to_owned);
        let message = configuration(Task::FetchPush, "goalward", &scaled).unwrap_err().to_string();
        assert!(message.contains("`environment.action_scale` must be none for sqil"), "{message}");
        let error = configuration(Task::Navigation, "goalward", &["method=magic".to_owned()]);
        let message = error.unwrap_err().to_string();
        assert!(message.contains("one of ") && message.contains("gaifo-s"), "{message}");
    }
}
