//! The command `goalward`: what users type, and what watches over a run's processes.
//!
//! It stands beside the data's way, not in it: no trajectory, score or weight passes through here.
//! It lays out the folder of a run, starts the actors, the learner and the proximity service as
//! processes of their own, starts again what dies, and shows the progress that the learner
//! publishes. If it dies, they notice and stop; `goalward train --resume` goes on.
//!
//! | module | what it does |
//! |---|---|
//! | `cli`, `commands` | the verbs, one file each |
//! | `plan` | which run is trained: a new folder or one that is continued |
//! | `settings` | `--set` beside the flags that set keys of their own |
//! | `description` | what the program that acts in a task says of it |
//! | `demonstrations` | checks a file of demonstrations, or has one recorded |
//! | `destination` | where a verb may write |
//! | `experiment` | plans of many runs |
//! | `cluster` | the engines of clusters that train them |
//! | `listening` | a run that lets actors of other machines in |
//! | `machine` | whether this machine has the memory and disk for a run |
//! | `supervisor` | the processes of a run, from start to end |
//! | `processes` | who takes part in a live run, and who is stopped or gone |
//! | `processor` | whether this machine can execute the build |
//! | `progress` | the progress of a run in one line |
//! | `progress_file` | the newest progress, for experiments |
//! | `child`, `programs` | processes that `goalward` starts |
//! | `choices` | values that flags are known to take |
//! | `event_files` | the event file for TensorBoard that it writes meanwhile |
//! | `companion_page` | the page that `goalward train` serves meanwhile |
//! | `answer` | a program asked for one answer, for the page |
//! | `other_reward` | another reward for what a run has recorded |
//! | `scenes` | recorded episodes with what a viewer draws |
//! | `figures` | what a verb found out, for people or as JSON |
//! | `headway` | how far a program is that was started for one piece of work |
//! | `limits` | whether the system lets a run's processes be large enough |
//! | `tasks` | tasks as the user names them |
//! | `output` | what the processes print |
//! | `summary` | the summary of a finished run, as a table |
//! | `full_log` | a log with observations, made of one with actions only |

mod answer;
mod child;
mod choices;
mod cli;
mod cluster;
mod commands;
mod companion_page;
mod demonstrations;
mod description;
mod destination;
mod event_files;
mod experiment;
mod figures;
mod full_log;
mod headway;
mod limits;
mod listening;
mod machine;
mod other_reward;
mod output;
mod plan;
mod processes;
mod processor;
mod programs;
mod progress;
mod progress_file;
mod scenes;
mod settings;
mod summary;
mod supervisor;
mod tasks;

use std::process::ExitCode;

use terminal::print::{all_is_printed, print_error};

/// The whole of `goalward`: reads the command line, does what it says, and prints a failure as one
/// line that begins with `goalward:`. The exit code is 0 if all went well, 1 after a failure, 2
/// after wrong usage, 3 if it finished but data was lost, and 130 if the user stopped it.
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
