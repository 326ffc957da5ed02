//! `goalward replay --verify`: the actor acts every recorded episode again and prints its figures as
//! JSON; this shows them.

use anyhow::{Result, bail, ensure};
use run::folder::RunFolder;
use serde::Deserialize;

use crate::figures;
use crate::print::print_line;
use crate::programs::{self, Program};
use crate::refusal::Refusal;

/// What the actor says.
#[derive(Debug, Deserialize)]
struct Verification {
    episodes: u64,
    steps: u64,
    equal: u64,
    first_difference: Option<String>,
    damaged: Vec<String>,
    seconds: f64,
}

/// Verifies a run's log: fails when an episode differs, and has lost data when a file is damaged.
pub(super) fn verify(folder: &RunFolder) -> Result<()> {
    let mut actor = Program::acting_in(&folder.config()?.task).command()?;
    let actor = actor.arg("verify").arg("--run").arg(folder.path());
    let verification: Verification = programs::figures(actor, "acting again")?;
    print_line(table(&verification).trim_end());
    let Verification { episodes, equal, damaged, .. } = verification;
    if let Some(difference) = verification.first_difference {
        bail!("{} of {episodes} episodes differ; the first: {difference}", episodes - equal);
    }
    if !damaged.is_empty() {
        return Err(Refusal::DataLost(damaged.join("; ")).into());
    }
    ensure!(episodes > 0, "{}: expected episodes to act again, found none", folder.log().display());
    Ok(())
}

fn table(verification: &Verification) -> String {
    let Verification { episodes, steps, equal, seconds, .. } = verification;
    let (equal, episodes) = (figures::count(*equal), figures::count(*episodes));
    let (steps, rate) = (figures::count(*steps), figures::rate(*steps as f64 / seconds));
    figures::table(&[
        ("the same", format!("{equal} of {episodes} episodes")),
        ("time", format!("{}, {steps} steps, {rate}", figures::duration(*seconds))),
    ])
}
