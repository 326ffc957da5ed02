//! `goalward replay --with`: the rewards that the recorded episodes would have earned from another reward model. The
//! proximity service computes them; this module shows them.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use protocol::durable::{self, TemporaryFolder};
use run::demonstrations::existing_file_of;
use run::folder::RunFolder;
use serde::{Deserialize, Serialize};

use super::curves::{self, Pair, Point};
use crate::destination;
use crate::full_log::{self, FullLog};
use crate::other_reward::OtherReward;
use crate::output_format::OutputFormat;
use crate::programs::{self, Program};
use terminal::numbers;
use terminal::refusal::{Refusal, wrong_usage};

/// The service's report.
#[derive(Debug, Deserialize, Serialize)]
struct Comparison {
    episodes: u64,
    all: Option<Pair>,
    reached: Option<Pair>,
    missed: Option<Pair>,
    correlation: Option<f64>,
    ordered: Option<Pair>,
    curve: Vec<Point>,
}

/// Names of the rewards, their configuration and their picture until they are in place.
const FILES: [&str; 3] = ["rewards.csv", "rewards.toml", "rewards.svg"];

/// Scores a log again with `changes` to the configuration of its reward, each `key=value`.
///
/// # Errors
/// Wrong usage, when a change is not of the reward.
pub(super) fn rescore(
    folder: &RunFolder,
    changes: &[String],
    out: Option<PathBuf>,
    force: bool,
    output: OutputFormat,
) -> Result<()> {
    let OtherReward { config, model } = OtherReward::of(folder, changes)?;
    if config.reward.model.imitates {
        existing_file_of(model.as_ref().unwrap_or(folder), &config).map_err(Refusal::usage)?;
    }
    let [out, configuration, picture] = files(folder, out, force)?;
    // The three files belong together, so they are put in place together.
    let made = TemporaryFolder::beside(&out).with_context(|| out.display().to_string())?;
    let [new_out, new_configuration, new_picture] = FILES.map(|name| made.path().join(name));
    fs::write(&new_configuration, config.to_text())?;
    let log = FullLog::of(folder)?;
    let mut service = Program::ProximityService.command()?;
    service.arg("rescore").arg("--run").arg(folder.path()).arg("--log").arg(log.folder());
    service.arg("--config").arg(&new_configuration).arg("--out").arg(&new_out);
    if let Some(model) = &model {
        service.arg("--model").arg(model.path());
    }
    let comparison: Comparison = programs::result_unless_stopped(&mut service, "scoring again")?;
    curves::draw(&comparison.curve, &new_picture)?;
    let places = [(new_out, &out), (new_configuration, &configuration), (new_picture, &picture)];
    for (new, place) in places {
        durable::rename(&new, place).with_context(|| place.display().to_string())?;
    }
    output.print(&comparison, |comparison| table(comparison, &out, &picture))?;
    full_log::refuse_loss(folder)
}

/// Returns the files for the rewards, their configuration and their picture.
fn files(folder: &RunFolder, out: Option<PathBuf>, force: bool) -> Result<[PathBuf; 3]> {
    type Check = fn(&Path, bool) -> Result<()>;
    let (out, check): (_, Check) = match out {
        Some(out) => (out, destination::file),
        None => (folder.path().join("rescored.csv"), destination::own_file),
    };
    let files = ["toml", "svg"].map(|ending| out.with_extension(ending));
    if files.contains(&out) {
        let shown = out.display();
        return Err(wrong_usage(format!(
            "--out {shown}: expected a name such as rewards.csv; .toml and .svg are written beside it"
        )));
    }
    let [configuration, picture] = files;
    let files = [out, configuration, picture];
    files.iter().try_for_each(|file| check(file, force))?;
    Ok(files)
}

fn table(comparison: &Comparison, out: &Path, picture: &Path) -> String {
    let Comparison { episodes, all, reached, missed, correlation, ordered, .. } = comparison;
    let pair = |pair: &Option<Pair>| match pair {
        Some(Pair { recorded, now }) => format!("{recorded:.4} recorded, {now:.4} now"),
        None => "no such episode".to_owned(),
    };
    let shares = |pair: &Option<Pair>| match pair {
        Some(Pair { recorded, now }) => {
            let [recorded, now] = [*recorded, *now].map(|share| numbers::percent(share, 1));
            format!("{recorded} recorded, {now} now")
        }
        None => "no such pair".to_owned(),
    };
    let correlation = correlation.map_or("none".to_owned(), |number| format!("{number:.3}"));
    let mut rows = vec![("episodes", numbers::count(*episodes))];
    // Neither, if the task does not tell success.
    if reached.is_some() || missed.is_some() {
        rows.push(("mean return, goal reached", pair(reached)));
        rows.push(("mean return, goal missed", pair(missed)));
        rows.push(("reached above missed, of all pairs", shares(ordered)));
    } else {
        rows.push(("mean return", pair(all)));
    }
    rows.push(("correlation of the returns", correlation));
    rows.push(("every episode in", out.display().to_string()));
    rows.push(("curves in", picture.display().to_string()));
    numbers::table(&rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_services_figures_become_a_table_and_get_names() {
        let text = r#"{"episodes": 1234, "all": [0.5, 0.25], "reached": [0.5, 0.25], "missed": null,
            "correlation": 0.98765, "ordered": [0.9, 0.8],
            "curve": [{"episodes": 3, "all": [0.125, 0.0], "reached": null, "missed": [0.125, 0.0]}]}"#;
        let [out, picture] = ["r/rescored.csv", "r/rescored.svg"].map(Path::new);
        let mut comparison: Comparison = serde_json::from_str(text).unwrap();
        let shown = table(&comparison, out, picture);
        let parts = ["1,234", "0.5000 recorded, 0.2500 now", "no such episode", "0.988", "80.0 %"];
        for part in parts {
            assert!(shown.contains(part), "expected {part} in\n{shown}");
        }
        let printed = serde_json::to_value(&comparison).unwrap();
        let pair = |recorded: f64, now: f64| serde_json::json!({"recorded": recorded, "now": now});
        assert_eq!(printed["reached"], pair(0.5, 0.25));
        assert_eq!(printed["ordered"], pair(0.9, 0.8));
        assert_eq!(printed["curve"][0]["missed"], pair(0.125, 0.0));
        (comparison.reached, comparison.ordered) = (None, None);
        let shown = table(&comparison, out, picture);
        assert!(!shown.contains("goal") && shown.contains("0.5000 recorded"), "{shown}");
    }
}
