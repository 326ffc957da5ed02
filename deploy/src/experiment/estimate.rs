//! Estimates what the runs that are left to train cost, by the pace of finished runs or by earlier measurements.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use run::config::RunConfig;
use serde::Deserialize;

use super::archive::Archive;
use super::planned_run::PlannedRun;
use super::training::{Standing, Training};

/// Total seconds and planned steps of finished runs: for each method of a task, for each task, and for all.
#[derive(Debug, Default)]
pub(super) struct Estimate {
    measured: BTreeMap<Kind, (f64, u64)>,
}

/// A task and a method; `None` stands for any.
type Kind = (Option<String>, Option<String>);

/// Returns the kinds that a run belongs to, the most specific first.
fn kinds(config: &RunConfig) -> [Kind; 3] {
    let task = Some(config.task.name.clone());
    [(task.clone(), Some(config.method.clone())), (task, None), (None, None)]
}

impl Estimate {
    /// Adds a run that finished in `seconds`. It counts by its planned steps, since behavioral cloning takes none.
    pub(super) fn add(&mut self, config: &RunConfig, seconds: f64) {
        for kind in kinds(config) {
            let (all_seconds, steps) = self.measured.entry(kind).or_default();
            *all_seconds += seconds;
            *steps += config.steps;
        }
    }

    /// Returns the seconds that a run takes, by the most similar finished runs; NaN if there are none.
    pub(super) fn seconds(&self, config: &RunConfig) -> f64 {
        kinds(config).iter().find_map(|kind| self.of_kind(kind, config)).unwrap_or(f64::NAN)
    }

    fn of_kind(&self, kind: &Kind, config: &RunConfig) -> Option<f64> {
        let &(seconds, steps) = self.measured.get(kind)?;
        Some(seconds / steps.max(1) as f64 * config.steps as f64)
    }

    /// Returns the estimate from runs of the same task and method; `None` if none of them is finished.
    fn of_the_like(&self, config: &RunConfig) -> Option<f64> {
        self.of_kind(&kinds(config)[0], config)
    }
}

/// Costs by reward model.
type OfLearner = BTreeMap<String, Cost>;

/// Costs of runs by task, policy learner and reward model, as `deploy/bench.sh --costs` measured them.
static MEASURED: LazyLock<BTreeMap<String, BTreeMap<String, OfLearner>>> = LazyLock::new(|| {
    toml::from_str(include_str!("../../costs.toml")).expect("costs.toml is sound")
});

/// Core-seconds of a run.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Cost {
    /// Core-seconds before the first step and after the last one.
    beside: f64,
    /// Core-seconds per million environment steps.
    million_steps: f64,
}

/// Returns the core-seconds of a run as measured for its task, policy learner and reward model; `None` if they were not
/// measured.
pub(crate) fn measured(config: &RunConfig) -> Option<f64> {
    let of_learner = MEASURED.get(&config.task.name)?.get(config.learner.name())?;
    let Cost { beside, million_steps } = of_learner.get(config.reward.model.name)?;
    // `beside` is the constant of a fitted line, which may lie below 0.
    Some((beside + million_steps * config.steps as f64 / 1e6).max(0.0))
}

/// The work that is left of the runs of plans.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Left {
    /// Runs that are not finished.
    pub(crate) runs: usize,
    /// Core-hours that they need, without runs of unknown cost.
    pub(crate) core_hours: f64,
    /// Unfinished runs of unknown cost.
    pub(crate) unknown: usize,
}

/// Returns the work that is left of `runs`.
pub(crate) fn left(runs: &[PlannedRun], archive: &mut Archive) -> Left {
    let mut finished = Estimate::default();
    let mut missing = Vec::new();
    for run in runs {
        let training = Training::of(run, archive);
        match training.summary() {
            Some(summary) => finished.add(&run.config, summary.processor_s),
            None => missing.push(training),
        }
    }
    let mut left = Left { runs: missing.len(), ..Left::default() };
    for training in missing {
        let config = &training.run.config;
        let part_left = training.standing().map_or(1.0, Standing::part_left);
        match finished.of_the_like(config).or_else(|| measured(config)) {
            Some(core_s) => left.core_hours += core_s / 3600.0 * part_left,
            None => left.unknown += 1,
        }
    }
    left
}

#[cfg(test)]
mod tests {

    use super::*;
    use run::tasks::configuration;

    fn config(task: &str, method: &str) -> RunConfig {
        let settings = [format!("method={method}"), "steps=1000".to_owned()];
        configuration(task, None, &settings).unwrap()
    }

    #[test]
    fn similar_runs_tell_more() {
        let mut estimate = Estimate::default();
        let [gail, bc] = ["gail", "bc"].map(|method| config("navigation", method));
        assert!(estimate.seconds(&gail).is_nan());
        estimate.add(&gail, 10.0);
        assert_eq!(estimate.seconds(&config("ant-reach", "gail")), 10.0);
        estimate.add(&bc, 2.0);
        assert_eq!((estimate.seconds(&gail), estimate.seconds(&bc)), (10.0, 2.0));
        assert_eq!(estimate.seconds(&config("navigation", "gaifo")), 6.0);
    }

    #[test]
    fn every_run_of_the_figures_was_measured() {
        let plans = concat!(env!("CARGO_MANIFEST_DIR"), "/experiments");
        let plans: Vec<_> =
            std::fs::read_dir(plans).unwrap().map(|entry| entry.unwrap().path()).collect();
        let plans = super::super::read_all(&plans, false).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let mut archive = Archive::open(folder.path());
        let runs = super::super::queue(&plans, &mut archive);
        let Left { runs: missing, core_hours, unknown } = left(&runs, &mut archive);
        assert_eq!((missing, unknown), (runs.len(), 0));
        assert!(core_hours > 1.0);
    }
}
