//! How long what is left will take, by the pace of the runs that are finished.

use std::collections::BTreeMap;

use run::config::RunConfig;

/// Seconds and planned steps of finished runs, added up: for each method of a task, for each task, and
/// for all.
#[derive(Debug, Default)]
pub(super) struct Estimate {
    measured: BTreeMap<Kind, (f64, u64)>,
}

/// A task and a method, either of which may be any.
type Kind = (Option<String>, Option<String>);

/// From the like to the unlike.
fn kinds(config: &RunConfig) -> [Kind; 3] {
    let task = Some(config.task.name.clone());
    [(task.clone(), Some(config.method.clone())), (task, None), (None, None)]
}

impl Estimate {
    /// Takes into account that a run was finished in so many seconds. It is measured by the steps it
    /// was planned with, for behavioral cloning takes none.
    pub(super) fn add(&mut self, config: &RunConfig, seconds: f64) {
        for kind in kinds(config) {
            let (all_seconds, steps) = self.measured.entry(kind).or_default();
            *all_seconds += seconds;
            *steps += config.steps;
        }
    }

    /// Seconds that a run takes, by the most similar ones that are finished; not a number if there
    /// are none.
    pub(super) fn seconds(&self, config: &RunConfig) -> f64 {
        let measured = kinds(config).into_iter().find_map(|kind| self.measured.get(&kind));
        measured.map_or(f64::NAN, |&(seconds, steps)| {
            seconds / steps.max(1) as f64 * config.steps as f64
        })
    }
}

#[cfg(test)]
mod tests {
    use run::config::DEFAULT_PRESET;

    use super::*;
    use run::tasks::configuration;

    fn config(task: &str, method: &str) -> RunConfig {
        let settings = [format!("method={method}"), "steps=1000".to_owned()];
        configuration(task, DEFAULT_PRESET, &settings).unwrap()
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
}
