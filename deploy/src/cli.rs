//! The command line: the verbs of `goalward`.

use std::error::Error;
use std::num::{IntErrorKind, ParseFloatError, ParseIntError};

use anyhow::Result;
use clap::error::{ContextKind, ErrorKind};
use clap::{Command, CommandFactory, Parser, Subcommand};

use crate::commands::{
    config, demonstrate, demonstrations, evaluate, experiment, export, join, log, methods, page,
    replay, report, runs, scale, shell, status, stop, task, tasks, train,
};
use run::diagnostics::Diagnostics;
use terminal::refusal::wrong_usage;
use terminal::voice::Voice;

/// What the exit codes mean.
const EXIT_CODES: &str = "Exit codes: 0 all well, 1 failure, 2 wrong usage, 3 finished but data was lost, \
                          130 stopped by the user.";

/// Trains policies from demonstrations without actions, with a learned goal-proximity reward.
#[derive(Debug, Parser)]
#[command(name = "goalward", version = protocol::build::version(), max_term_width = 100)]
#[command(after_help = EXIT_CODES, mut_subcommands = with_negative_numbers)]
struct CommandLine {
    #[command(subcommand)]
    verb: Verb,
    #[command(flatten)]
    voice: Voice,
}

#[derive(Debug, Subcommand)]
enum Verb {
    /// Train a policy: record demonstrations, start all processes, show progress.
    Train(train::Arguments),
    /// Contribute this machine's actors to a run on another machine.
    Join(join::Arguments),
    /// Show the status of a run, whether it is live, finished or stopped.
    Status(status::Arguments),
    /// Give a run more or fewer actors while it trains; the result does not change.
    Scale(scale::Arguments),
    /// Stop a run as Ctrl-C does; `goalward train --resume` continues it.
    Stop(stop::Arguments),
    /// List the runs of a folder, newest first.
    Runs(runs::Arguments),
    /// Show runs in a browser: live training curves, settings and results.
    Page(page::Arguments),
    /// List the built-in tasks.
    Tasks(tasks::Arguments),
    /// List the available methods.
    Methods(methods::Arguments),
    /// List the configuration keys with their values and remarks.
    Config(config::Arguments),
    /// Write the task file of a Python environment, such as gym:CartPole-v1.
    Task(task::Arguments),
    /// Record demonstrations with a task's expert.
    Demonstrate(demonstrate::Arguments),
    /// Convert data sets to files of demonstrations, or describe such files.
    #[command(subcommand)]
    Demonstrations(demonstrations::Verb),
    /// Run episodes with a run's newest policy.
    Evaluate(evaluate::Arguments),
    /// Export a run's policy and reward model to files for other programs.
    Export(export::Arguments),
    /// Train the runs of plans, such as those of the paper's figures.
    Experiment(experiment::Arguments),
    /// Replay a run's log: re-simulate its episodes, retrain from them, publish or rescore them.
    Replay(replay::Arguments),
    /// Write a report on runs or on the figures of plans: a web page with charts, and CSV tables.
    Report(report::Arguments),
    /// Inspect or repair log files, restore observations, or write 3D scenes.
    #[command(subcommand)]
    Log(log::Verb),
    /// Print a shell completion script.
    Completions(shell::Completions),
    /// Write pages for `man`.
    Manual(shell::Manual),
}

/// Parses the command line and runs its verb.
pub(crate) fn run() -> Result<()> {
    let line = CommandLine::try_parse().or_else(|error| match error.kind() {
        ErrorKind::DisplayHelp
        | ErrorKind::DisplayVersion
        | ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand => error.exit(),
        _ => Err(wrong_usage(refusal(&error))),
    })?;
    Diagnostics::ForPeople.begin(line.voice.begin());
    match line.verb {
        Verb::Train(arguments) => train::run(arguments),
        Verb::Join(arguments) => join::run(&arguments),
        Verb::Status(arguments) => status::run(&arguments),
        Verb::Scale(arguments) => scale::run(&arguments),
        Verb::Stop(arguments) => stop::run(&arguments),
        Verb::Runs(arguments) => runs::run(&arguments),
        Verb::Page(arguments) => page::run(arguments),
        Verb::Tasks(arguments) => tasks::run(&arguments),
        Verb::Methods(arguments) => methods::run(&arguments),
        Verb::Config(arguments) => config::run(&arguments),
        Verb::Task(arguments) => task::run(&arguments),
        Verb::Demonstrate(arguments) => demonstrate::run(&arguments),
        Verb::Demonstrations(verb) => demonstrations::run(&verb),
        Verb::Evaluate(arguments) => evaluate::run(&arguments),
        Verb::Export(arguments) => export::run(&arguments),
        Verb::Experiment(arguments) => experiment::run(&arguments),
        Verb::Replay(arguments) => replay::run(arguments),
        Verb::Report(arguments) => report::run(arguments),
        Verb::Log(verb) => log::run(&verb),
        Verb::Completions(arguments) => {
            shell::completions(&arguments, CommandLine::command());
            Ok(())
        }
        Verb::Manual(arguments) => shell::manual(&arguments, CommandLine::command()),
    }
}

/// Lets the values of a verb's flags be negative numbers, which clap would take for flags of their own: only then can
/// [`refusal`] say what was expected.
fn with_negative_numbers(verb: Command) -> Command {
    verb.mut_subcommands(with_negative_numbers).mut_args(|argument| {
        let has_value = !argument.is_positional() && argument.get_action().takes_values();
        argument.allow_negative_numbers(has_value)
    })
}

/// Returns what is wrong with a command line. For numbers, this function says what was expected: clap only has the
/// message of Rust's parser, which does not, or that of a range in its own notation.
fn refusal(error: &clap::Error) -> String {
    let part = |kind| error.get(kind).map(ToString::to_string);
    let number = error.source().and_then(number_expected);
    match (number, part(ContextKind::InvalidArg), part(ContextKind::InvalidValue)) {
        (Some(number), Some(argument), Some(value)) => {
            // Clap adds the name of the value, as in `--steps <STEPS>`.
            let flag = argument.split_once(' ').map_or(argument.as_str(), |(flag, _)| flag);
            format!("{flag}: expected {number}, found {value}")
        }
        _ => in_one_line(&error.to_string()),
    }
}

/// Returns which numbers a failed parser expected; `None` if it does not parse numbers.
fn number_expected(failed: &(dyn Error + 'static)) -> Option<String> {
    if failed.is::<ParseFloatError>() {
        return Some("a number".to_owned());
    }
    let Some(unparsed) = failed.downcast_ref::<ParseIntError>() else {
        return range_expected(&failed.to_string());
    };
    let is_large = *unparsed.kind() == IntErrorKind::PosOverflow;
    let expected =
        if is_large { "a smaller number" } else { "a whole number that is not negative" };
    Some(expected.to_owned())
}

/// Returns which numbers clap expected, from its message about one outside of a range, such as `65 is not in 0..=64`;
/// `None` for other messages. A range without an end has no `=` there, but the largest number.
fn range_expected(said: &str) -> Option<String> {
    let (_, range) = said.split_once(" is not in ")?;
    let (first, last) = range.split_once("..")?;
    Some(match last.strip_prefix('=') {
        Some(last) => format!("a whole number from {first} to {last}"),
        None => format!("a whole number from {first}"),
    })
}

/// Returns clap's message about a wrong command line in one line, with its tips but without the usage.
fn in_one_line(text: &str) -> String {
    let text = text.strip_prefix("error: ").unwrap_or(text);
    let said = text.split("\n\n").filter(|part| !part.starts_with("Usage:"));
    let said = said.filter(|part| !part.starts_with("For more information"));
    let lines = said.map(|part| part.split_whitespace().collect::<Vec<_>>().join(" "));
    lines.collect::<Vec<_>>().join("; ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_well_formed() {
        CommandLine::command().debug_assert();
    }

    #[test]
    fn the_documented_lines_are_understood() {
        for line in [
            "goalward train navigation --preset paper --method goal-proximity --seed 3 --steps 9 \
             --coverage 0.25 --actors 4 --demonstrations d.mcap --run r --set ppo.clip=0.3",
            "goalward train",
            "goalward train --resume --run r",
            "goalward train --listen 0.0.0.0:7447",
            "goalward join hub:7447 --key join.toml --actors 8 --name node-7",
            "goalward join --run r --other-build",
            "goalward status r --json",
            "goalward -q status r",
            "goalward train -vv --color never --json",
            "goalward scale r --actors 4",
            "goalward scale r --actors 0 --host node-7",
            "goalward stop r",
            "goalward train --dry-run --no-page",
            "goalward config ppo. uncertainty --task fetch-push --method bc --preset paper --json",
            "goalward completions zsh",
            "goalward manual --out m",
            "goalward log scene r 3:17 0:1 --out s.mcap --force",
            "goalward runs",
            "goalward runs r --json",
            "goalward page",
            "goalward page r s --host 0.0.0.0 --port 0",
            "goalward tasks --json",
            "goalward methods --json",
            "goalward task gym:FetchPush-v4 --set environment.kwargs.x=3 --out t.toml --force",
            "goalward demonstrate navigation --episodes 250 --coverage 0.5 --seed 2 --out d.mcap --json",
            "goalward demonstrate gym:x --expert m:f --set environment.kwargs.x=3 --episodes 9 --out d.mcap",
            "goalward demonstrations import d.npz --task gym:x --out d.mcap --keys a,b --success all",
            "goalward demonstrations import d.npz --task t.toml --out d.mcap --actions a,b",
            "goalward demonstrations info d.mcap",
            "goalward evaluate r --episodes 100 --json",
            "goalward evaluate r --actions mode --seed 7 --force --other-build",
            "goalward export r --format safetensors --checkpoint 40 --out e --force --json",
            "goalward experiment a.toml b.toml --quick --out e --jobs 2",
            "goalward experiment a.toml --dry-run --json",
            "goalward replay r --verify --json",
            "goalward replay r --retrain --until 40 --out s",
            "goalward replay r --publish --speed 2.5",
            "goalward replay r --with reward.uncertainty=0.1 --with model=s --out r.csv",
            "goalward report r s --out web",
            "goalward report figure3.toml r --quick --experiments e",
            "goalward log info r --json",
            "goalward log repair a.mcap b.mcap",
            "goalward log restore r --out s --json",
        ] {
            CommandLine::try_parse_from(line.split_whitespace()).unwrap();
        }
    }

    #[test]
    fn nonsense_is_refused() {
        for line in [
            "goalward fly",
            "goalward train --steps -5",
            "goalward train --seed one",
            "goalward train --wings 2",
            "goalward train -q -v",
            "goalward train --color blue",
            "goalward demonstrate navigation --out d.mcap",
            "goalward demonstrate navigation --episodes 0 --out d.mcap",
            "goalward log info",
            "goalward report",
            "goalward export r --format pickle",
            "goalward experiment",
            "goalward experiment a.toml --jobs 0",
            "goalward replay r",
            "goalward replay r --verify --retrain",
            "goalward scale r --actors 65",
            "goalward scale r --host node-7",
            "goalward train --listen 7447",
            "goalward join hub:7447",
            "goalward join --run r --key join.toml",
            "goalward join --run r --actors 65",
            "goalward replay r --verify --until 40",
        ] {
            let error = CommandLine::try_parse_from(line.split_whitespace()).unwrap_err();
            let text = refusal(&error);
            assert!(!text.contains('\n') && !text.contains("Usage"), "{line}: {text}");
        }
    }

    #[test]
    fn a_wrong_line_is_explained_in_one() {
        for (line, expected) in [
            (
                "train --step 5",
                "unexpected argument '--step' found; tip: a similar argument exists: '--steps'",
            ),
            ("train --steps -5", "--steps: expected a whole number that is not negative, found -5"),
            ("train --seed one", "--seed: expected a whole number that is not negative, found one"),
            (
                "train --steps 99999999999999999999",
                "--steps: expected a smaller number, found 99999999999999999999",
            ),
            ("train --noise wide", "--noise: expected a number, found wide"),
            ("evaluate r --episodes 0", "--episodes: expected a whole number from 1, found 0"),
            ("scale r --actors 65", "--actors: expected a whole number from 0 to 64, found 65"),
            ("page --port -1", "--port: expected a whole number from 0 to 65535, found -1"),
            (
                "experiment a.toml --jobs -1",
                "--jobs: expected a whole number from 1 to 256, found -1",
            ),
            ("join --run r --actors 0", "--actors: expected a whole number from 1 to 64, found 0"),
            (
                "stop -1",
                "unexpected argument '-1' found; tip: to pass '-1' as a value, use '-- -1'",
            ),
        ] {
            let words = ["goalward"].into_iter().chain(line.split(' '));
            let error = CommandLine::try_parse_from(words).unwrap_err();
            assert_eq!(refusal(&error), expected);
        }
    }

    #[test]
    fn a_negative_number_is_the_value_of_any_flag() {
        for line in [
            "evaluate r --seed -1",
            "evaluate r --episodes -1",
            "evaluate r --checkpoint -1",
            "export r --checkpoint -1",
            "replay r --retrain --until -1",
            "scale r --actors -1",
            "join --run r --actors -1",
            "demonstrate navigation --seed -1",
            "demonstrations import d.npz --task t --out d.mcap --episodes -1",
        ] {
            let words = ["goalward"].into_iter().chain(line.split(' '));
            let error = CommandLine::try_parse_from(words).unwrap_err();
            let said = refusal(&error);
            let expected = "expected a whole number that is not negative, found -1";
            assert!(said.ends_with(expected), "{line}: {said}");
        }
        for line in ["replay r --publish --speed -1", "train --noise -0.5"] {
            let words = ["goalward"].into_iter().chain(line.split(' '));
            CommandLine::try_parse_from(words).unwrap();
        }
    }
}
