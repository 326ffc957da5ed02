//! `goalward demonstrations`: converts data sets to files of demonstrations, by the Python package `goalward`.

use std::path::PathBuf;
use std::process::Command;

use anyhow::{Context, Result};
use run::config::set_by_user;

use crate::output_format::OutputFormat;
use crate::{answer, destination, programs, tasks};
use terminal::refusal::wrong_usage;

/// Environment variable that names the interpreter that has the package; it is also that of Python environments.
const INTERPRETER: &str = "GOALWARD_PYTHON";

/// The part of the package that reads and writes demonstrations.
const MODULE: &str = "goalward.demonstrations";

/// The formats that the package reads.
const FORMATS: [&str; 7] = ["auto", "npz", "csv", "minari", "lerobot", "robomimic", "mcap"];

/// The verbs of `goalward demonstrations`.
#[derive(Debug, clap::Subcommand)]
pub(crate) enum Verb {
    /// Convert a data set to a file of demonstrations: npz, CSV, Minari, LeRobot, robomimic, MCAP or rosbag2.
    Import(Box<Import>),
    /// Say what a file of demonstrations holds.
    Info {
        /// The file.
        file: PathBuf,
        #[command(flatten)]
        output: OutputFormat,
    },
}

/// Flags of `goalward demonstrations import`.
#[derive(Debug, clap::Args)]
pub(crate) struct Import {
    /// File or folder of the data set.
    source: PathBuf,
    /// Task: a name, the path of a task's file, or a Python environment such as gym:FetchPush-v4.
    #[arg(long)]
    task: String,
    /// Sets a key of the task's environment, such as environment.kwargs.x=3; can be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    settings: Vec<String>,
    /// MCAP file to write.
    #[arg(long, value_name = "FILE.mcap")]
    out: PathBuf,
    /// Overwrites an existing file, but never one in a run's folder.
    #[arg(long)]
    force: bool,
    /// Format of the data set, by default detected.
    #[arg(long, value_parser = FORMATS)]
    format: Option<String>,
    /// Observation keys of the data set, in the order of the task's observation; by default all except
    /// success signals. A bag with several topics needs them.
    #[arg(long, value_name = "KEY,KEY")]
    keys: Option<String>,
    /// Keys of the data set's actions, which are choices or numbers in [-1, 1]; by default only states are taken.
    #[arg(long, value_name = "KEY,KEY")]
    actions: Option<String>,
    /// Which episodes reach the goal: `all`, each at its last observation, or the key of a success signal.
    #[arg(long, value_name = "all|KEY")]
    success: Option<String>,
    /// Whether the keys must match the names in the task's labels, by default match.
    #[arg(long, value_parser = ["match", "ignore"])]
    labels: Option<String>,
    /// Takes at most this many episodes.
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..))]
    episodes: Option<u64>,
}

impl Import {
    /// Returns the flags that tell the package what to take from the data set.
    fn selection(&self) -> Vec<String> {
        let Import { format, keys, actions, success, labels, .. } = self;
        let episodes = self.episodes.map(|count| count.to_string());
        let flags = [
            ("--format", format),
            ("--keys", keys),
            ("--actions", actions),
            ("--success", success),
            ("--labels", labels),
            ("--episodes", &episodes),
        ];
        let given = flags.into_iter().filter_map(|(flag, value)| Some((flag, value.as_ref()?)));
        given.flat_map(|(flag, value)| [flag.to_owned(), value.clone()]).collect()
    }
}

/// Runs the verb.
pub(crate) fn run(verb: &Verb) -> Result<()> {
    match verb {
        Verb::Import(arguments) => import(arguments),
        Verb::Info { file, output } => {
            package("info", |package| package.arg(file).args(output.is_json().then_some("--json")))
        }
    }
}

fn import(arguments: &Import) -> Result<()> {
    let Import { source, task, settings, out, force, .. } = arguments;
    destination::file(out, *force)?;
    refuse_without_effect(task, settings)?;
    let config = tasks::configuration(task, None, settings)?;
    let spec = serde_json::to_string(&config.task).context("a task as JSON")?;
    package("import", |package| {
        package.arg(source).args(["--task-json", &spec, "--task-argument", task]);
        package.arg("--out").arg(out);
        package.args(force.then_some("--overwrite")).args(arguments.selection())
    })
}

/// Refuses settings that do not change what the task is: an environment of Python is made with those of its own table,
/// and any other task is what its file says.
fn refuse_without_effect(task: &str, settings: &[String]) -> Result<()> {
    let has_effect = |key: &str| tasks::is_of_python(task) && key.starts_with("environment.");
    match set_by_user(settings)?.into_iter().find(|(key, _)| !has_effect(key)) {
        None => Ok(()),
        Some((key, value)) => Err(wrong_usage(format!(
            "--set {key}={value}: expected environment.KEY=VALUE and an environment of Python, such as \
             gym:CartPole-v1, found --task {task}"
        ))),
    }
}

/// Runs the package, which itself says what it did, or why it did not.
fn package(verb: &str, with: impl FnOnce(&mut Command) -> &mut Command) -> Result<()> {
    let interpreter = std::env::var(INTERPRETER).unwrap_or_else(|_| "python3".to_owned());
    let named = |what: &str| format!("expected {what} {interpreter}, or where {INTERPRETER} says");
    let mut look = Command::new(&interpreter);
    let found = look.args(["-c", &format!("import {MODULE}")]).output();
    let found = found.map_err(|error| wrong_usage(format!("{}: {error}", named("Python as"))))?;
    if !found.status.success() {
        let said = String::from_utf8_lossy(&found.stderr);
        return Err(wrong_usage(format!(
            "{}, found {}; `pip install ./python` installs it",
            named("the Python package goalward in"),
            answer::last_words(&said).unwrap_or("none")
        )));
    }
    let mut command = Command::new(&interpreter);
    let status = with(command.args(["-m", MODULE, verb])).status().context("starting Python")?;
    programs::expect_success(status)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use clap::{Args, FromArgMatches};

    use super::*;

    #[test]
    fn formats_are_those_of_the_package() {
        let file = "../python/src/goalward/demonstrations/formats.py";
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(file);
        let text = std::fs::read_to_string(path).unwrap();
        let named = |line: &str| {
            let (name, _) = line.trim().strip_prefix('"')?.split_once("\": Format(")?;
            Some(name.to_owned())
        };
        let mut expected: Vec<_> = text.lines().filter_map(named).chain(["auto".into()]).collect();
        let mut found = FORMATS.map(str::to_owned);
        expected.sort();
        found.sort();
        assert_eq!(found.as_slice(), expected);
    }

    #[test]
    fn what_to_take_is_passed_on() {
        let words = ["import", "d.npz", "--task", "t", "--out", "d.mcap", "--actions", "a,b"];
        let import = Import::augment_args(clap::Command::new("import")).get_matches_from(words);
        let selection = Import::from_arg_matches(&import).unwrap().selection();
        assert_eq!(selection, ["--actions", "a,b"]);
    }

    #[test]
    fn settings_are_of_an_environment_of_python() {
        let refused = |task: &str, setting: &str| {
            refuse_without_effect(task, &[setting.to_owned()]).map_err(|error| error.to_string())
        };
        assert_eq!(refused("gym:x", "environment.kwargs.x=3"), Ok(()));
        for (task, setting) in [("gym:x", "steps=9"), ("fetch-push", "environment.noise=2.0")] {
            let said = refused(task, setting).unwrap_err();
            assert!(said.starts_with(&format!("--set {setting}: expected")), "{said}");
            assert!(said.ends_with(task), "{said}");
        }
    }

    #[test]
    fn what_the_package_would_refuse_is_no_flag() {
        let is_understood = |flag: &str, value: &str| {
            let words = ["import", "d.npz", "--task", "t", "--out", "d.mcap", flag, value];
            Import::augment_args(clap::Command::new("import")).try_get_matches_from(words).is_ok()
        };
        assert!(FORMATS.iter().all(|format| is_understood("--format", format)));
        assert!(is_understood("--labels", "ignore") && is_understood("--episodes", "3"));
        for (flag, value) in
            [("--format", "json"), ("--labels", "foo"), ("--episodes", "0"), ("--episodes", "-1")]
        {
            assert!(!is_understood(flag, value), "{flag} {value}");
        }
    }
}
