//! The configuration file of each task, carried within the program.

use protocol::task::Task;

/// The text of `deploy/tasks/TASK.toml`.
pub(crate) fn file_of(task: Task) -> &'static str {
    match task {
        Task::Navigation => include_str!("../tasks/navigation.toml"),
        Task::FetchPick => include_str!("../tasks/fetch_pick.toml"),
        Task::FetchPush => include_str!("../tasks/fetch_push.toml"),
        Task::AntReach => include_str!("../tasks/ant_reach.toml"),
    }
}

#[cfg(test)]
mod tests {
    use protocol::config::RunConfig;

    use super::*;

    #[test]
    fn every_preset_of_every_task_is_a_whole_configuration() {
        for task in Task::ALL {
            for preset in ["goalward", "paper", "authors"] {
                let config = RunConfig::assemble(file_of(task), preset, &[]).unwrap();
                assert_eq!((config.task, config.preset.as_str()), (task, preset));
            }
        }
    }
}
