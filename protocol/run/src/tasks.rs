//! The configuration files of tasks and methods: those built into the program, and the user's own tasks.

use std::fs;
use std::path::Path;

use protocol::Error;
use protocol::error::out_of_range;
use toml::{Table, Value};

use crate::config::RunConfig;

/// The text of `deploy/methods.toml`.
const METHODS: &str = include_str!("../../../deploy/methods.toml");

/// The paper's tasks, in its order, each with the text of its file.
const BUILT_IN: [(&str, &str); 4] = [
    ("navigation", include_str!("../../../deploy/tasks/navigation.toml")),
    ("fetch-pick", include_str!("../../../deploy/tasks/fetch_pick.toml")),
    ("fetch-push", include_str!("../../../deploy/tasks/fetch_push.toml")),
    ("ant-reach", include_str!("../../../deploy/tasks/ant_reach.toml")),
];

/// The task that is trained unless another is named.
pub const DEFAULT_TASK: &str = BUILT_IN[0].0;

/// Returns the effective configuration of a task under a preset, with `key=value` settings; the
/// method is one of them. The task is a name, or the path of a file such as `deploy/tasks/*.toml`.
/// If the file names a program by a relative path, that is relative to the file's folder.
///
/// # Errors
/// If there is no such task, or its configuration is invalid.
pub fn configuration(
    task: &str,
    preset: Option<&str>,
    settings: &[String],
) -> Result<RunConfig, Error> {
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

/// Returns the same as [`configuration`] for a task whose file has this text; `origin` says where the text comes from.
///
/// # Errors
/// If the configuration is invalid.
pub fn of_text(
    text: &str,
    origin: &str,
    preset: Option<&str>,
    settings: &[String],
) -> Result<RunConfig, Error> {
    RunConfig::assemble(text, METHODS, preset, settings).map_err(|error| match &error {
        Error::ConfigurationText { origin: own, .. } if own == "file" => error.of_origin(origin),
        _ => error,
    })
}

/// Returns the names of the paper's tasks, in its order.
pub fn names() -> impl Iterator<Item = &'static str> {
    BUILT_IN.iter().map(|(name, _)| *name)
}

/// Returns the names of the methods, each with a one-line description.
///
/// # Panics
/// Never: a test parses the file.
pub fn methods() -> Vec<(String, String)> {
    let methods = METHODS.parse::<Table>().expect("the file is read by every test");
    let about = |changes: &Value| changes.get("about").and_then(Value::as_str).map(str::to_owned);
    methods
        .iter()
        .map(|(name, changes)| (name.clone(), about(changes).unwrap_or_default()))
        .collect()
}

/// Returns a task's place among those of the paper; other tasks come after them.
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
                let config = configuration(task, Some(preset), &[]).unwrap();
                assert_eq!((config.task.name.as_str(), config.preset.as_str()), (task, preset));
            }
        }
    }

    /// The paper's Table 2: learning rate, minibatches, epochs, steps of a rollout, entropy coefficient.
    const TABLE_2: [(&str, f64, u64, u64, u64, f64); 4] = [
        ("navigation", 0.001, 4, 4, 4096, 0.01),
        ("fetch-push", 0.001, 32, 10, 4096, 0.01),
        ("fetch-pick", 0.0003, 32, 10, 4096, 0.01),
        ("ant-reach", 0.0003, 32, 10, 16_000, 0.001),
    ];

    /// The paper's Table 3: lambda, delta, learning rate, batch, agent experience.
    const TABLE_3: [(&str, f64, f64, f64, usize, usize); 4] = [
        ("navigation", 0.1, 0.01, 0.001, 32, 4096),
        ("fetch-push", 0.01, 0.02, 0.001, 128, 4096),
        ("fetch-pick", 0.1, 0.02, 0.001, 128, 4096),
        ("ant-reach", 0.01, 0.01, 0.0001, 128, 16_000),
    ];

    #[test]
    fn the_preset_paper_has_the_values_of_the_papers_tables() {
        for (task, learning_rate, minibatches, epochs, steps, entropy_coefficient) in TABLE_2 {
            let config = configuration(task, Some("paper"), &[]).unwrap();
            let (ppo, rollout) = (&config.ppo, &config.rollout);
            let found = (ppo.learning_rate, ppo.minibatches, ppo.epochs);
            assert_eq!(found, (learning_rate, minibatches, epochs), "{task}");
            assert_eq!(rollout.lanes * rollout.lane_steps, steps, "{task}");
            assert_eq!(ppo.entropy_coefficient, entropy_coefficient, "{task}");
            assert_eq!((ppo.gamma, ppo.learning_rate_decay), (0.99, true), "{task}");
            assert_eq!(config.policy.normalize_observations, task != "navigation", "{task}");
        }
        for (task, uncertainty, delta, learning_rate, batch, experience) in TABLE_3 {
            let reward = configuration(task, Some("paper"), &[]).unwrap().reward;
            let found = (reward.uncertainty, reward.delta, reward.learning_rate);
            assert_eq!(found, (uncertainty, delta, learning_rate), "{task}");
            assert_eq!((reward.batch, reward.experience), (batch, experience), "{task}");
            assert_eq!(reward.ensemble, 5, "{task}");
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
                let config =
                    configuration(task, Some(preset), &[format!("method={method}")]).unwrap();
                assert_eq!(config.method, *method);
            }
        }
        let scaled =
            ["method=sqil", "environment.action_scale=[0.1, 0.6, 0.15]"].map(str::to_owned);
        let message = configuration("fetch-push", None, &scaled).unwrap_err().to_string();
        assert!(message.contains("`environment.action_scale` must be none for sqil"), "{message}");
        let error = configuration("navigation", None, &["method=magic".to_owned()]);
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
        // The method `linear` needs a delta that fits the task's horizon.
        for method in methods.keys().filter(|method| *method != "linear") {
            let config = configuration(path, None, &[format!("method={method}")]).unwrap();
            assert_eq!(config.task.program, Some(folder.path().join("my-actor")), "{method}");
        }
        fs::write(&file, own.replace("80", "\"eighty\"")).unwrap();
        let refusal = configuration(path, None, &[]).unwrap_err().to_string();
        assert!(refusal.contains("eighty") && !refusal.contains('\n'), "{refusal}");
        fs::write(&file, "[task\n").unwrap();
        let refusal = configuration(path, None, &[]).unwrap_err().to_string();
        assert!(refusal.contains(path) && refusal.contains("line 1"), "{refusal}");
        let refusal = configuration("chess", None, &[]).unwrap_err().to_string();
        assert!(refusal.contains("navigation, fetch-pick"), "{refusal}");
    }

    #[test]
    fn what_soft_q_learning_reads_depends_on_the_actions_and_not_on_the_observations() {
        let own = "[task]\nname = \"cart\"\nobservation.vector.len = 4\n\
                   action.discrete.count = 2\nhorizon_steps = 80\nprogram = \"my-actor\"\n";
        let judged = |setting: &str| {
            of_text(own, "cart", None, &["method=sqil", setting].map(str::to_owned))
        };
        judged("ppo.max_gradient_norm=0.1").unwrap();
        for setting in ["sqil.hidden=[8]", "sqil.tune_temperature=false"] {
            let refusal = judged(setting).unwrap_err().to_string();
            assert!(refusal.contains("the task's actions are discrete"), "{refusal}");
        }
    }

    #[test]
    fn a_run_s_own_configuration_is_the_file_of_the_same_run() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("config.toml");
        let path = file.to_str().unwrap();
        let changes = ["rollout.lanes=9", "evaluation.episodes=7"].map(str::to_owned);
        for (method, _) in methods() {
            let settings = [&changes[..], &[format!("method={method}")]].concat();
            let config = configuration("fetch-push", Some("paper"), &settings).unwrap();
            fs::write(&file, config.to_text()).unwrap();
            for named in [&[], &settings[2..]] {
                assert_eq!(configuration(path, None, named).unwrap(), config);
            }
            let longer = configuration(path, Some("paper"), &["steps=9000000".to_owned()]).unwrap();
            assert_eq!(longer, RunConfig { steps: 9_000_000, ..config });
        }
        let refusal = |preset, settings: &[&str]| {
            let settings: Vec<String> = settings.iter().map(|&one| one.to_owned()).collect();
            configuration(path, preset, &settings).unwrap_err().to_string()
        };
        let of_method = refusal(None, &["method=bc"]);
        assert!(
            of_method.contains("`method` must be temporal-distance, as in the run"),
            "{of_method}"
        );
        for other in ["goalward", "authors"] {
            let of_preset = refusal(Some(other), &[]);
            assert!(of_preset.contains("`preset` must be paper, as in the run"), "{of_preset}");
        }
    }
}
