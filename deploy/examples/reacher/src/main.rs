//! The actor of the tasks `reacher` and `reacher-held`: goalward starts it wherever it would start its own.

mod arm;

use std::process::ExitCode;

use actor::{Expert, Registration};

use arm::{Goal, Reacher};

const TASKS: &[Registration] = &[
    Registration::new("reacher", |setting| {
        Ok(Box::new(Reacher::new(Goal::EndsEpisode, setting.read()?)?))
    })
    .with_expert(Expert::Scripted),
    Registration::new("reacher-held", |setting| {
        Ok(Box::new(Reacher::new(Goal::IsHeld, setting.read()?)?))
    })
    .with_expert(Expert::Scripted),
];

fn main() -> ExitCode {
    actor::main(TASKS)
}
