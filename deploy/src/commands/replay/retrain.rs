//! `goalward replay --retrain`: learner and proximity service train again, from the log of a run
//! instead of environments, and must arrive at the same weights after every iteration.

use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;

use anyhow::{Context, Result, bail, ensure};
use mcap_log::{Contents, Record, read_contents};
use protocol::weights;
use run::config::RunConfig;
use run::demonstrations::existing_file_of;
use run::folder::RunFolder;
use run::holder::Work;
use run::origin::demonstrations_sha256;
use run::summary::Summary;
use serde::Serialize;

use crate::destination;
use crate::full_log::{self, FullLog};
use crate::lock::Lock;
use crate::output_format::OutputFormat;
use crate::prepared_run::PreparedRun;
use crate::progress::ProgressView;
use crate::provenance;
use crate::supervisor::{Outcome, Source, block_on_supervision};
use terminal::numbers;
use terminal::print::print_remark;
use terminal::refusal::{Refusal, stopped, wrong_usage};

/// What is updated.
const POLICY: &str = "policy";
const REWARD_MODEL: &str = "reward model";

/// Hashes of the weights after every update, by what was updated and its version.
type Hashes = BTreeMap<(&'static str, u64), String>;

/// Trains a run again from its log and compares the weights.
///
/// # Errors
/// For the first update after which the weights differ, or that a finished run has and the new training lacks.
pub(super) fn retrain(
    recorded: &RunFolder,
    until: Option<u64>,
    out: Option<PathBuf>,
    output: OutputFormat,
) -> Result<()> {
    let kept = out.is_some();
    out.as_deref().map(destination::outside_runs).transpose()?;
    let folder = out.map_or_else(|| cleared(recorded), |out| Ok(RunFolder::new(out)))?;
    let mut prepared = PreparedRun::copy_of(configuration(recorded)?, folder)?;
    let expected = hashes(recorded)?;
    ensure!(!expected.is_empty(), "expected updates in {}, found none", recorded.log().display());
    let full = FullLog::of(recorded)?;
    let log = fs::canonicalize(full.folder()).context("the log")?;
    if let Some(words) = provenance::other_build(recorded)? {
        print_remark(&format!("{words}; the weights may differ"));
    }
    let lock = prepared.lay_out()?;
    let mut view = ProgressView::new();
    let source = Source::Log { log, iterations: until };
    let outcome = block_on_supervision(&prepared.folder, &source, &mut view);
    view.finish();
    if outcome? == Outcome::Stopped {
        let shown = prepared.folder.path().display();
        print_remark(&format!("stopped; what was trained again is in {shown}"));
        return Err(stopped());
    }
    let found = hashes(&prepared.folder)?;
    let same = compare(&expected, &found)?;
    let whole = full_log::refuse_loss(recorded);
    // The log of a finished run has everything that training to the end needs.
    if until.is_none() && whole.is_ok() && matches!(Summary::of_run(recorded), Ok(Some(_))) {
        expect_all(&expected, &found)?;
    }
    output.print(&same, Same::table)?;
    drop(lock);
    if !kept {
        fs::remove_dir_all(prepared.folder.path()).context("removing the run trained again")?;
    }
    whole
}

/// Returns the folder for training a run again for the comparison only, and removes what an earlier attempt left there.
fn cleared(recorded: &RunFolder) -> Result<RunFolder> {
    let folder = RunFolder::new(recorded.path().join("retrained"));
    if folder.is_run() {
        // The lock is taken and released again: a folder on NFS cannot be removed while a file in it is open.
        drop(Lock::take(&folder, Work::CleaningUp)?);
        fs::remove_dir_all(folder.path()).context("removing what was trained again before")?;
    }
    Ok(folder)
}

/// Returns the recorded run's configuration, with the present path of its demonstrations. Changed demonstrations are
/// refused here, since the folder of the new run does not say which ones the recorded run had.
fn configuration(recorded: &RunFolder) -> Result<RunConfig> {
    let mut config = recorded.config()?;
    if config.imitates() {
        let file = existing_file_of(recorded, &config).map_err(Refusal::usage)?;
        let file = fs::canonicalize(&file)
            .map_err(|error| wrong_usage(format!("demonstrations {}: {error}", file.display())))?;
        demonstrations_sha256(recorded, &config).map_err(Refusal::usage)?;
        config.demonstrations.file = Some(file);
    }
    Ok(config)
}

fn hashes(folder: &RunFolder) -> Result<Hashes> {
    let mut hashes = Hashes::new();
    for entry in read_contents(&folder.log(), Contents::Updates)? {
        match entry?.record {
            Record::PolicyUpdate(update) => {
                hashes.insert((POLICY, update.policy_version), update.weights_sha256);
            }
            Record::RewardUpdate(update) => {
                hashes.insert((REWARD_MODEL, update.model_version), update.weights_sha256);
            }
            _ => {}
        }
    }
    Ok(hashes)
}

/// Updates that gave the same weights again.
#[derive(Debug, Serialize)]
struct Same {
    /// Number of updates whose weights were compared.
    updates: u64,
    /// Hash after the last of them.
    policy_sha256: Option<String>,
    /// `None` for a method that learns no reward.
    reward_model_sha256: Option<String>,
}

impl Same {
    fn table(&self) -> String {
        let Same { updates, policy_sha256, reward_model_sha256 } = self;
        let weights = format!("the weights after {} updates", numbers::count(*updates));
        let hashes =
            [("policy sha256", policy_sha256), ("reward model sha256", reward_model_sha256)];
        let hashes = hashes.into_iter().filter_map(|(title, hash)| Some((title, hash.clone()?)));
        numbers::table(&std::iter::once(("the same", weights)).chain(hashes).collect::<Vec<_>>())
    }
}

fn compare(expected: &Hashes, found: &Hashes) -> Result<Same> {
    let mut updates = 0;
    // Sorted by version, so that the first difference in time comes first.
    let mut names: Vec<_> = found.keys().filter(|name| expected.contains_key(name)).collect();
    names.sort_by_key(|(kind, version)| (*version, *kind));
    for name in names {
        let (kind, version) = name;
        ensure!(
            expected[name] == found[name],
            "the {kind} differs first after update {version}: expected {}, found {}",
            expected[name],
            found[name]
        );
        updates += 1;
    }
    ensure!(updates > 0, "expected updates to compare, found none");
    let last = |kind: &str| {
        let newest = found.iter().rev().find(|((name, _), _)| *name == kind);
        newest.map(|(_, hash)| hash.clone())
    };
    let policy_sha256 = last(POLICY);
    let reward_model_sha256 = last(REWARD_MODEL).filter(|hash| *hash != weights::sha256([]));
    Ok(Same { updates, policy_sha256, reward_model_sha256 })
}

fn expect_all(expected: &Hashes, found: &Hashes) -> Result<()> {
    let missing =
        expected.keys().filter(|name| !found.contains_key(name)).min_by_key(|(_, version)| version);
    let Some((kind, version)) = missing else { return Ok(()) };
    bail!(
        "expected update {version} of the {kind}, as the log has it, found that the training again ended before"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_update_that_differs_is_named() {
        let hashes = |of_policy: [&str; 3], of_reward_model: [&str; 2]| {
            let named = |kind, hashes: &[&str]| -> Hashes {
                (1..)
                    .zip(hashes)
                    .map(|(number, hash)| ((kind, number), (*hash).to_owned()))
                    .collect()
            };
            let mut all = named(POLICY, &of_policy);
            all.extend(named(REWARD_MODEL, &of_reward_model));
            all
        };
        let recorded = hashes(["a", "b", "c"], ["x", "y"]);
        compare(&recorded, &recorded).unwrap();
        let other = hashes(["a", "b", "d"], ["x", "z"]);
        let error = compare(&recorded, &other).unwrap_err().to_string();
        assert!(error.contains("reward model differs first after update 2: expected y"), "{error}");
        assert!(compare(&recorded, &Hashes::new()).is_err());
        let of_nothing = weights::sha256([]);
        let without_model = hashes(["a", "b", "c"], [&of_nothing, &of_nothing]);
        let same = compare(&without_model, &without_model).unwrap();
        assert_eq!((same.policy_sha256.as_deref(), same.reward_model_sha256), (Some("c"), None));

        expect_all(&recorded, &recorded).unwrap();
        let short = hashes(["a", "b", "c"], ["x", "y"])
            .into_iter()
            .filter(|((_, version), _)| *version < 2);
        let error = expect_all(&recorded, &short.collect()).unwrap_err().to_string();
        assert!(error.contains("expected update 2 of the"), "{error}");
    }
}
