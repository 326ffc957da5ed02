//! `goalward evaluate`: runs episodes with a policy of a run.
//!
//! The actor runs them and prints the result as JSON; this module shows it to people.

use std::path::PathBuf;

use anyhow::Result;
use run::config::ActionChoice;
use run::folder::{POLICY_FILE, RunFolder};
use serde::{Deserialize, Serialize};

use crate::output_format::OutputFormat;
use crate::programs::{self, Program};
use crate::summary::success;
use crate::{choices, chosen_checkpoint, description, destination, machine};
use terminal::numbers;
use terminal::refusal::wrong_usage;

/// Flags of `goalward evaluate`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Folder of the run.
    run: PathBuf,
    /// Episodes to run; by default as many as at the end of training.
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..))]
    episodes: Option<u64>,
    /// How actions are chosen: drawn or the most probable; by default as at the end of training.
    #[arg(long, value_name = "CHOICE", value_parser = choices::actions())]
    actions: Option<ActionChoice>,
    /// Seed of the episodes; by default the run's own, whose episodes are those at the end of training.
    #[arg(long)]
    seed: Option<u64>,
    /// Checkpoint to evaluate, by its number of iterations; by default the newest.
    #[arg(long, value_name = "N")]
    checkpoint: Option<u64>,
    /// File for the episodes; by default evaluation-*.mcap in the run's folder.
    #[arg(long, value_name = "FILE.mcap")]
    out: Option<PathBuf>,
    /// Overwrites an existing file, such as that of an earlier evaluation of this policy.
    #[arg(long)]
    force: bool,
    /// Evaluates although a Python module of the environment has changed since training.
    #[arg(long)]
    other_build: bool,
    #[command(flatten)]
    output: OutputFormat,
}

/// The actor's report.
#[derive(Debug, Deserialize, Serialize)]
struct Evaluation {
    episodes: u64,
    success_rate: Option<f64>,
    mean_return: f64,
    mean_steps: f64,
    policy_version: u64,
    file: PathBuf,
}

/// Evaluates a run; the exit code is that of the actor.
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let folder = RunFolder::new(&arguments.run);
    let config = folder.config()?;
    let episodes = arguments.episodes.unwrap_or(config.evaluation.episodes);
    if episodes == 0 {
        return Err(wrong_usage(format!(
            "{}: expected at least 1 episode, found evaluation.episodes = 0; --episodes N says how many",
            folder.path().display()
        )));
    }
    let actions = arguments.actions.unwrap_or(config.evaluation.actions);
    let other_seed = arguments.seed.filter(|seed| *seed != config.seed);
    machine::require_end(episodes as f64 * f64::from(config.task.spec().horizon_steps), 0.0)?;
    let iteration = chosen_checkpoint::iterations(&folder, arguments.checkpoint, &[POLICY_FILE])?;
    match &arguments.out {
        Some(file) => destination::file(file, arguments.force)?,
        None => {
            let file = folder.evaluation_file(iteration, episodes, actions, other_seed);
            destination::own_file(&file, arguments.force)?;
        }
    }
    description::of_begun(config.clone(), arguments.other_build)?;
    let mut actor = Program::acting_in(&config.task).command()?;
    actor.arg("evaluate").arg("--run").arg(folder.path());
    actor.args(["--episodes", &episodes.to_string(), "--actions", actions.name()]);
    actor.args(other_seed.map(|seed| format!("--seed={seed}")));
    actor.args(["--checkpoint", &iteration.to_string()]);
    actor.args(arguments.other_build.then_some("--other-build"));
    if let Some(file) = &arguments.out {
        actor.arg("--out").arg(file);
    }
    arguments.output.print(&programs::result_unless_stopped(&mut actor, "evaluating")?, table)
}

fn table(evaluation: &Evaluation) -> String {
    let Evaluation { episodes, success_rate, mean_return, mean_steps, policy_version, file } =
        evaluation;
    numbers::table(&[
        ("success", success(*success_rate, *episodes, Some(*mean_return))),
        ("steps per episode", numbers::number(*mean_steps)),
        ("policy version", numbers::count(*policy_version)),
        ("recorded in", file.display().to_string()),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_actors_figures_become_a_table() {
        let text = r#"{"episodes": 200, "success_rate": 0.965, "mean_return": 0.5, "mean_steps": 14.25,
            "policy_version": 367, "file": "r/evaluation-v000367-200-sample.mcap"}"#;
        let table = table(&serde_json::from_str(text).unwrap());
        for part in [
            "96.5 % of 200 episodes; mean return 0.5",
            "14.2",
            "367\n",
            "r/evaluation-v000367-200-sample.mcap",
        ] {
            assert!(table.contains(part), "expected {part} in\n{table}");
        }
    }
}
