//! `goalward demonstrate`: a task's expert records demonstrations.
//!
//! The actor records them and prints the result as JSON; this module passes on what the user wants and shows it to
//! people.

use std::collections::BTreeMap;
use std::path::PathBuf;

use anyhow::{Result, ensure};
use protocol::setting::{EXPERT, MAKE, Setting};
use run::config::{RunConfig, set_by_user};
use run::folder::RunFolder;
use serde::{Deserialize, Serialize};
use toml::Value;

use crate::demonstrations::Recording;
use crate::output_format::OutputFormat;
use crate::tasks;
use crate::{description, destination, machine, settings};
use terminal::numbers;
use terminal::refusal::{stopped, wrong_usage};

/// Keys of the demonstrations that are set by flags of their own.
const BY_FLAGS: [(&str, &str); 2] =
    [("demonstrations.episodes", "--episodes"), ("demonstrations.file", "--out")];

/// Flags of `goalward demonstrate`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Task: navigation, fetch-pick, fetch-push, ant-reach, the path of a task's file, or an environment of
    /// Python such as gym:CartPole-v1.
    task: String,
    /// Episodes to record.
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..))]
    episodes: u64,
    /// Fraction of the starts and goals that demonstrations may use, above 0 and at most 1; by default all of them.
    #[arg(long)]
    coverage: Option<f64>,
    /// Spread of the starts and goals, in the task's own unit.
    #[arg(long)]
    noise: Option<f64>,
    /// Run whose policy demonstrates; by default the task's own expert does.
    #[arg(long, value_name = "RUN")]
    policy: Option<PathBuf>,
    /// Expert for a Python environment: a function that is called with the environment at the start of each episode
    /// and returns a function from observations to actions.
    #[arg(long, value_name = "MODULE:FUNCTION", conflicts_with = "policy")]
    expert: Option<String>,
    /// Sets an environment or demonstrations key, such as environment.kwargs.x=3; can be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    settings: Vec<String>,
    /// Seed of the starts and goals.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// MCAP file to write.
    #[arg(long, value_name = "FILE.mcap")]
    out: PathBuf,
    /// Overwrites an existing file, but never one in a run's folder.
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    output: OutputFormat,
}

/// The actor's report.
#[derive(Debug, Deserialize, Serialize)]
struct Recorded {
    episodes: u64,
    steps: u64,
    failures: Option<u64>,
    file: PathBuf,
}

/// Records demonstrations; the exit code is that of the actor.
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let &Arguments { ref task, episodes, ref policy, seed, ref out, force, .. } = arguments;
    destination::file(out, force)?;
    let named = own_settings(arguments)?;
    let of_policy = policy.as_ref().map(|run| RunFolder::new(run).config()).transpose()?;
    let config = tasks::configuration(task, None, &arguments.settings)?;
    if let Some(RunConfig { task, .. }) =
        of_policy.filter(|other| other.task.name != config.task.name)
    {
        let expected = format!("expected a run of {}", config.task.name);
        return Err(wrong_usage(format!("--policy: {expected}, found one of {}", task.name)));
    }
    refuse_expert_unless_of_python(arguments, &config)?;
    let task = &config.task;
    machine::require_end(episodes as f64 * f64::from(task.spec().horizon_steps), 0.0)?;
    let setting = setting(arguments, &named, &config);
    let setting = description::complete_setting(task, &setting, policy.is_none())?;
    let policy = policy.as_deref();
    let recording = Recording { task, episodes, setting, policy, seed, file: out, force };
    let ended = recording.record(&mut recording.actor()?)?.ok_or_else(stopped)?;
    arguments.output.print(&ended.result()?, table)
}

fn table(recorded: &Recorded) -> String {
    let Recorded { episodes, steps, failures, file } = recorded;
    let failures = match failures {
        Some(failures) => format!("{} further episodes", numbers::count(*failures)),
        None => "the task tells no success: all were kept and none was cut at a goal".to_owned(),
    };
    numbers::table(&[
        ("demonstrations", numbers::count(*episodes)),
        ("steps", numbers::count(*steps)),
        ("failures", failures),
        ("recorded in", file.display().to_string()),
    ])
}

/// Returns the keys that `--set` names. They must be of the environment or the demonstrations, since a recording has no
/// others, and must not contradict the flags.
fn own_settings(arguments: &Arguments) -> Result<BTreeMap<String, Value>> {
    let Arguments { coverage, noise, policy, expert, settings, .. } = arguments;
    let named = set_by_user(settings)?;
    for (key, flag) in BY_FLAGS {
        if let Some(value) = named.get(key) {
            return Err(wrong_usage(format!(
                "--set: expected no {key}, found {key}={value}: {flag} sets it"
            )));
        }
    }
    let is_own = |key: &String| {
        ["demonstrations.", "environment."].iter().any(|table| key.starts_with(table))
    };
    if let Some((key, value)) = named.iter().find(|(key, _)| !is_own(key)) {
        return Err(wrong_usage(format!(
            "--set: expected environment.KEY=VALUE or demonstrations.KEY=VALUE, found {key}={value}"
        )));
    }
    let of_expert = format!("demonstrations.{EXPERT}");
    if policy.is_some() && named.contains_key(&of_expert) {
        return Err(wrong_usage(format!(
            "--set {of_expert}: expected no expert together with --policy"
        )));
    }
    let flags = [
        coverage.map(|share| format!("demonstrations.coverage={}", Value::Float(share))),
        noise.map(|noise| format!("demonstrations.noise={}", Value::Float(noise))),
        expert.clone().map(|expert| format!("{of_expert}={}", Value::String(expert))),
    ];
    settings::refuse_contradiction(&flags.into_iter().flatten().collect::<Vec<_>>(), settings)?;
    Ok(named)
}

/// Refuses an expert of Python for a task that is not acted in Python, and would take it for a setting.
fn refuse_expert_unless_of_python(arguments: &Arguments, config: &RunConfig) -> Result<()> {
    let is_of_python = config.environment.0.contains_key(MAKE);
    let task = &arguments.task;
    ensure!(
        is_of_python || arguments.expert.is_none(),
        wrong_usage(format!("--expert: expected an environment of Python, found {task}"))
    );
    Ok(())
}

/// Returns the setting that the demonstrations are recorded in, with the flags applied. The coverage and noise of the
/// task's file are for its runs: unless the user gives them here, they are the environment's own.
fn setting(arguments: &Arguments, named: &BTreeMap<String, Value>, config: &RunConfig) -> Setting {
    let Arguments { coverage, noise, expert, .. } = arguments;
    let given = |key: &str| {
        let of = |table: &str| named.get(&format!("{table}.{key}")).cloned();
        of("demonstrations").or_else(|| of("environment"))
    };
    let mut setting = config.demonstration_setting();
    for (key, flag) in [("coverage", coverage), ("noise", noise)] {
        setting.0.remove(key);
        let value = flag.map(Value::Float).or_else(|| given(key));
        setting.0.extend(value.map(|value| (key.to_owned(), value)));
    }
    let expert = expert.clone().map(|expert| (EXPERT.to_owned(), Value::String(expert)));
    setting.0.extend(expert);
    setting
}

#[cfg(test)]
mod tests {
    use super::*;

    fn arguments(settings: &[&str]) -> Arguments {
        Arguments {
            task: "fetch-push".to_owned(),
            episodes: 1,
            coverage: None,
            noise: None,
            policy: None,
            expert: None,
            settings: settings.iter().map(|&setting| setting.to_owned()).collect(),
            seed: 1,
            out: PathBuf::from("d.mcap"),
            force: false,
            output: OutputFormat::default(),
        }
    }

    #[test]
    fn no_failure_is_counted_where_success_is_not_told() {
        let of = |failures: &str| {
            let text = r#"{"episodes": 2, "steps": 1500, "file": "d.mcap", "failures": "#;
            table(&serde_json::from_str(&format!("{text}{failures}}}")).unwrap())
        };
        let told = "  demonstrations  2\n  steps           1,500\n  failures        3 further episodes\n  \
                    recorded in     d.mcap\n";
        assert_eq!(of("3"), told);
        assert!(of("null").contains("  failures        the task tells no success"));
    }

    #[test]
    fn what_a_flag_sets_is_no_setting() {
        let said = own_settings(&arguments(&["demonstrations.episodes=7"])).unwrap_err();
        assert!(said.to_string().ends_with(": --episodes sets it"), "{said}");
        own_settings(&arguments(&["demonstrations.noise=2.0"])).unwrap();
    }

    #[test]
    fn only_python_has_experts_of_python() {
        let config = tasks::configuration("fetch-push", None, &[]).unwrap();
        let given = Arguments { expert: Some("foo:bar".to_owned()), ..arguments(&[]) };
        let said = refuse_expert_unless_of_python(&given, &config).unwrap_err().to_string();
        assert_eq!(said, "--expert: expected an environment of Python, found fetch-push");
        refuse_expert_unless_of_python(&arguments(&[]), &config).unwrap();
    }

    #[test]
    fn what_is_given_holds_and_what_the_file_has_for_runs_does_not() {
        let of = |settings: &[&str], noise| {
            let arguments = Arguments { noise, ..arguments(settings) };
            let config = tasks::configuration("fetch-push", None, &arguments.settings).unwrap();
            let named = set_by_user(&arguments.settings).unwrap();
            setting(&arguments, &named, &config).0.get("noise").and_then(Value::as_float)
        };
        assert_eq!(of(&[], None), None);
        assert_eq!(of(&["environment.noise=3.0"], None), Some(3.0));
        let both = ["environment.noise=3.0", "demonstrations.noise=2.0"];
        assert_eq!(of(&both, None), Some(2.0));
        assert_eq!(of(&both, Some(1.5)), Some(1.5));
    }
}
