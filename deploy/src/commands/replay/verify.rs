//! `goalward replay --verify`: the actor acts every recorded episode again and prints its result as JSON; this module
//! shows it.

use anyhow::{Result, bail, ensure};
use run::folder::RunFolder;
use serde::{Deserialize, Serialize};

use crate::description;
use crate::output_format::OutputFormat;
use crate::programs::{self, Program};
use terminal::numbers;
use terminal::refusal::Refusal;

/// The actor's report.
#[derive(Debug, Deserialize, Serialize)]
struct Verification {
    episodes: u64,
    steps: u64,
    equal: u64,
    first_difference: Option<String>,
    damaged: Vec<String>,
    seconds: f64,
}

/// Verifies a run's log. Fails if an episode differs; reports lost data if a file is damaged.
pub(super) fn verify(folder: &RunFolder, output: OutputFormat) -> Result<()> {
    let config = folder.config()?;
    let mut actor = Program::acting_in(&config.task).command()?;
    let actor = actor.arg("verify").arg("--run").arg(folder.path());
    let verification: Verification = programs::result_unless_stopped(actor, "acting again")?;
    output.print(&verification, table)?;
    let Verification { episodes, equal, damaged, .. } = verification;
    if let Some(difference) = verification.first_difference {
        let differing = episodes - equal;
        let changed = description::of_begun(config, false).err();
        let changed = changed.map(|refusal| format!("; {refusal:#}")).unwrap_or_default();
        bail!("{differing} of {episodes} episodes differ; the first: {difference}{changed}");
    }
    if !damaged.is_empty() {
        return Err(Refusal::DataLost(damaged.join("; ")).into());
    }
    ensure!(
        episodes > 0,
        "{}: expected episodes to re-simulate, found none",
        folder.log().display()
    );
    Ok(())
}

fn table(verification: &Verification) -> String {
    let Verification { episodes, steps, equal, seconds, .. } = verification;
    let (equal, episodes) = (numbers::count(*equal), numbers::count(*episodes));
    let (steps, rate) = (numbers::count(*steps), numbers::rate(*steps as f64 / seconds));
    numbers::table(&[
        ("the same", format!("{equal} of {episodes} episodes")),
        ("time", format!("{}, {steps} steps, {rate}", numbers::duration(*seconds))),
    ])
}
