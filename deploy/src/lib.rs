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
//! | `demonstrations` | checks a file of demonstrations, or has one recorded |
//! | `experiment` | plans of many runs |
//! | `supervisor` | the processes of a run, from start to end |
//! | `progress` | the progress of a run in one line |
//! | `status_line` | such a line, on a terminal and in a pipe |
//! | `output` | what the processes print |
//! | `summary` | figures of a finished run |
//! | `figure`, `report` | comparisons of runs as data, and as a page with pictures |
//! | `chart` | curves as SVG |
//! | `full_log` | a log with observations, made of one with actions only |
//! | `figures` | how numbers are written |
//! | `refusal` | exit codes |

mod chart;
mod cli;
mod commands;
mod demonstrations;
mod experiment;
mod figure;
mod figures;
mod full_log;
mod output;
mod plan;
mod programs;
mod progress;
mod refusal;
mod report;
mod status_line;
mod summary;
mod supervisor;
mod tasks;

use std::io::{IsTerminal, Write};
use std::process::ExitCode;

/// The whole of `goalward`: reads the command line, does what it says, and prints a failure as one
/// line that begins with `goalward:`. The exit code is 0 if all went well, 1 after a failure, 2
/// after wrong usage and 3 if it finished but data was lost.
pub fn main() -> ExitCode {
    let filter = tracing_subscriber::EnvFilter::try_from_default_env()
        .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new("error"));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_ansi(std::io::stderr().is_terminal())
        .with_writer(std::io::stderr)
        // Otherwise a disk that does not take the line would end the process in a panic.
        .log_internal_errors(false)
        .init();
    match cli::run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            if !refusal::is_explained(&error) {
                writeln!(std::io::stderr(), "goalward: {error:#}").ok();
            }
            refusal::exit_code(&error)
        }
    }
}
