//! The configuration files of tasks and methods: those carried within the program, and tasks of the
//! user's own.

use std::fs;
use std::path::Path;

use protocol::Error;
use protocol::error::out_of_range;
use toml::{Table, Value};

use crate::config::RunConfig;

/// The text of `deploy/methods.toml`.
const METHODS: &str = include_str!("../../../deploy/methods.toml");

/// The tasks of the paper, in its order, with the text of each one's file.
const BUILT_IN: [(&str, &str); 4] = [
    ("navigation", include_str!("../../../deploy/tasks/navigation.toml")),
    ("fetch-pick", include_str!("../../../deploy/tasks/fetch_pick.toml")),
    ("fetch-push", include_str!("../../../deploy/tasks/fetch_push.toml")),
    ("ant-reach", include_str!("../../../deploy/tasks/ant_reach.toml")),
];

/// The task that is trained unless another one is asked for.
pub const DEFAULT_TASK: &str = BUILT_IN[0].0;

/// The effective configuration of a task under a preset, with `key=value` settings; the method is
/// one of them. The task is a name, or the path of a file such as `deploy/tasks/*.toml`; a program
/// that the file names lies beside it unless its path is absolute.
///
/// # Errors
/// When there is no such task, or its configuration is not sound.
pub fn configuration(task: &str, preset: &str, settings: &[String]) -> Result<RunConfig, Error> {
    if let Some((_, file)) = BUILT_IN.iter().find(|(name, _)| *name == task) {
        return RunConfig::assemble(file, METHODS, preset, settings);
    }
    let path = Path::new(task);
    if !path.exists() {
        let known = BUILT_IN.map(|(name, _)| name).join(", ");
        return Err(out_of_range("task", &format!("{known} or the path of a task's file"), task));
    }
    let failed = |message: String| Error::ConfigurationText { origin: task.to_owned(), message };
    let file = fs::read_to_string(path).map_err(|error| failed(error.to_string()))?;
    let mut config = of_text(&file, task, preset, settings)?;
    if let (Some(program), Some(folder)) = (&mut config.task.program, path.parent()) {
        *program = folder.join(&program);
    }
    Ok(config)
}

/// The same of a task whose file has this text; `origin` says where it comes from.
///
/// # Errors
/// When the configuration is not sound.
pub fn of_text(
    text: &str,
    origin: &str,
    preset: &str,
    settings: &[String],
) -> Result<RunConfig, Error> {
    RunConfig::assemble(text, METHODS, preset, settings).map_err(|error| match error {
        Error::ConfigurationText { origin: own, message } if own == "file" => {
            Error::ConfigurationText { origin: origin.to_owned(), message }
        }
        other => other,
    })
}

/// Names of the tasks of the paper, in its order.
pub fn names() -> impl Iterator<Item = &'static str> {
    BUILT_IN.iter().map(|(name, _)| *name)
}

/// Names of the methods, and what each is in a line.
///
/// # Panics
/// Never: a test reads the file.
pub fn methods() -> Vec<(String, String)> {
    let methods = METHODS.parse::<Table>().expect("the file is read by every test");
    let about = |changes: &Value| changes.get("about").and_then(Value::as_str).map(str::to_owned);
    methods
        .iter()
        .map(|(name, changes)| (name.clone(), about(changes).unwrap_or_default()))
        .collect()
}

/// A task's place among those of the paper; those of others come behind.
pub fn place(task: &str) -> usize {
    BUILT_IN.iter().position(|(name, _)| *name == task).unwrap_or(BUILT_IN.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_preset_of_every_task_is_a_whole_configuration() {
        for (task, _) in BUILT_IN {
            for preset in ["goalward", "paper", "authors"] {
                let config = configuration(task, preset, &[]).unwrap();
                assert_eq!((config.task.name.as_str(), config.preset.as_str()), (task, preset));
            }
        }
    }

    #[test]
    fn every_method_is_a_whole_configuration_of_every_task() {
        let methods = METHODS.parse::<Table>().unwrap();
        assert!(methods.len() > 15, "{methods:?}");
        assert!(super::methods().iter().all(|(_, about)| about.len() > 10), "each is explained");
        for (task, method) in
            BUILT_IN.into_iter().flat_map(|(task, _)| methods.keys().map(move |name| (task, name)))
        {
            for preset in ["goalward", "paper", "authors"] {
                let config = configuration(task, preset, &[format!("method={method}")]).unwrap();
                assert_eq!(config.method, *method);
            }
        }
        let scaled =
            ["method=sqil", "environment.action_scale=[0.1, 0.6, 0.15]"].map(str::to_owned);
        let message = configuration("fetch-push", "goalward", &scaled).unwrap_err().to_string();
        assert!(message.contains("`environment.action_scale` must be none for sqil"), "{message}");
        let error = configuration("navigation", "goalward", &["method=magic".to_owned()]);
        let message = error.unwrap_err().to_string();
        assert!(message.contains("one of ") && message.contains("gaifo-s"), "{message}");
    }

    #[test]
    fn a_task_of_the_user_s_is_a_file_of_a_few_lines() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("pendulum.toml");
        let path = file.to_str().unwrap();
        let own = "[task]\nname = \"pendulum\"\nobservation.vector.len = 3\n\
                   action.continuous.len = 1\nhorizon_steps = 80\nprogram = \"my-actor\"\n";
        fs::write(&file, own).unwrap();
        let methods = METHODS.parse::<Table>().unwrap();
        // Labels that fall by the horizon are of one horizon.
        for method in methods.keys().filter(|method| *method != "linear") {
            let config = configuration(path, "goalward", &[format!("method={method}")]).unwrap();
            assert_eq!(config.task.program, Some(folder.path().join("my-actor")), "{method}");
            let whole = folder.path().join("config.toml");
            fs::write(&whole, config.to_text()).unwrap();
            let again = configuration(whole.to_str().unwrap(), "goalward", &[]).unwrap();
            assert_eq!(again, config, "a run's own configuration is the file of its task, too");
        }
        fs::write(&file, own.replace("80", "\"eighty\"")).unwrap();
        let refusal = configuration(path, "goalward", &[]).unwrap_err().to_string();
        assert!(refusal.contains("eighty") && !refusal.contains('\n'), "{refusal}");
        fs::write(&file, "[task\n").unwrap();
        let refusal = configuration(path, "goalward", &[]).unwrap_err().to_string();
        assert!(refusal.contains(path) && refusal.contains("line 1"), "{refusal}");
        let refusal = configuration("chess", "goalward", &[]).unwrap_err().to_string();
        assert!(refusal.contains("navigation, fetch-pick"), "{refusal}");
    }
}
