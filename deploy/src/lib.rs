//! The command `goalward`: the command line, and the supervisor of a run's processes.
//!
//! It is not part of the data path: no trajectory, score or weight passes through here. It lays out the folder of a
//! run, starts the actors, the learner and the proximity service as processes of their own, restarts those that die,
//! and shows the progress that the learner publishes. If it dies, they notice and stop; `goalward train --resume`
//! continues the run.
//!
//! | module | what it does |
//! |---|---|
//! | `cli`, `commands` | the verbs, one file each |
//! | `prepared_run` | which run is trained: a new one, or one that is continued |
//! | `provenance` | whether a run is continued with what it began with |
//! | `settings` | checks `--set` against the flags that set keys of their own |
//! | `description` | the description of a task by the program that acts in it |
//! | `demonstrations` | checks a file of demonstrations, or records one |
//! | `destination` | where a verb may write |
//! | `experiment` | plans of many runs |
//! | `cluster` | cluster engines that train the runs of plans |
//! | `listening` | a run that actors on other machines can join |
//! | `lock` | the lock of a run's folder, and who holds it |
//! | `machine` | whether this machine has the memory and disk for a run |
//! | `supervisor` | the processes of a run, from start to end |
//! | `processes` | the processes of a live run, and which of them are stopped or gone |
//! | `processor` | whether this machine can execute the build |
//! | `progress` | the progress of a run in one line |
//! | `progress_file` | the newest progress in a file, for experiments and the page |
//! | `child`, `programs` | processes that `goalward` starts |
//! | `choices` | known values of flags |
//! | `event_files` | the TensorBoard event file written during training |
//! | `companion_page` | the page that `goalward train` serves during training |
//! | `answer` | runs a program for one answer, for the page |
//! | `other_reward` | another reward for the recorded episodes of a run |
//! | `scenes` | recorded episodes as scenes for viewers |
//! | `headway` | progress of a program that was started for one piece of work |
//! | `limits` | whether the system's resource limits suffice for a run |
//! | `tasks` | tasks as the user names them |
//! | `named_runs` | runs as the user names them |
//! | `output` | the output of processes |
//! | `output_format` | the results of a verb, as a table or as JSON |
//! | `summary` | the summary of a finished run, as a table |
//! | `full_log` | a log with observations, restored from one with only actions |

mod answer;
mod child;
mod choices;
mod chosen_checkpoint;
mod cli;
mod cluster;
mod commands;
mod companion_page;
mod demonstrations;
mod description;
mod destination;
mod event_files;
mod experiment;
mod full_log;
mod headway;
mod limits;
mod listening;
mod lock;
mod machine;
mod named_runs;
mod other_reward;
mod output;
mod output_format;
mod prepared_run;
mod processes;
mod processor;
mod programs;
mod progress;
mod progress_file;
mod provenance;
mod scenes;
mod settings;
mod summary;
mod supervisor;
mod tasks;

use std::process::ExitCode;

use terminal::print::{all_is_printed, print_error};

/// Runs `goalward`: reads the command line, runs its verb, and prints a failure as one line that begins with
/// `goalward:`. The exit code is 0 if all went well, 1 after a failure, 2 after wrong usage, 3 if it finished but data
/// was lost, and 130 if the user stopped it.
pub fn main() -> ExitCode {
    if !processor::suffices() {
        return ExitCode::FAILURE;
    }
    match cli::run() {
        Ok(()) if all_is_printed() => ExitCode::SUCCESS,
        Ok(()) => ExitCode::FAILURE,
        Err(error) => {
            if !terminal::refusal::is_explained(&error) {
                print_error(&format!("{error:#}"));
            }
            terminal::refusal::exit_code(&error)
        }
    }
}
