//! The success that the authors published for a run's method, task and setting.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use protocol::table::{flat, parse_setting};
use protocol::task::ObservationSpec;
use run::config::RunConfig;
use run::tasks;
use serde::{Deserialize, Serialize};
use toml::{Table, Value};

/// The plans whose panels have anchors of their own; other plans repeat these.
const PLANS: [&str; 6] = [
    include_str!("../../experiments/figure3.toml"),
    include_str!("../../experiments/figure4.toml"),
    include_str!("../../experiments/figure6.toml"),
    include_str!("../../experiments/figure8.toml"),
    include_str!("../../experiments/figure9.toml"),
    include_str!("../../experiments/figure12.toml"),
];

/// The panel whose curve was not read off. Its anchor stands for a phrase in the paper.
const QUOTED: &str = "pick-50";

/// The part of a plan that matters here.
#[derive(Deserialize)]
struct Plan {
    panel: Vec<Panel>,
}

#[derive(Deserialize)]
struct Panel {
    name: String,
    task: String,
    #[serde(default)]
    set: Vec<String>,
    #[serde(default)]
    anchors: BTreeMap<String, f64>,
}

/// The published success rates of a panel, by method, and the settings that they are for.
struct Published {
    panel: String,
    task: String,
    settings: BTreeMap<String, Value>,
    anchors: BTreeMap<String, f64>,
}

static PUBLISHED: LazyLock<Vec<Published>> = LazyLock::new(|| {
    let plans = PLANS.iter().map(|plan| toml::from_str(plan).expect("a test reads the plans"));
    plans.flat_map(|plan: Plan| plan.panel).map(Published::of).collect()
});

/// A success rate that the authors published.
#[derive(Debug, PartialEq, Serialize)]
pub(crate) struct Success {
    rate: f64,
    /// What the rate is, in words.
    source: &'static str,
}

/// Returns the success that the authors published for a run's method; `None` if there is nothing for the run's task and
/// setting.
pub(crate) fn success(config: &RunConfig) -> Option<Success> {
    let values = flat(&Table::try_from(config).ok()?);
    let fits = |published: &&Published| {
        let holds = |(key, value): (&String, &Value)| values.get(key) == Some(value);
        published.task == config.task.name && published.settings.iter().all(holds)
    };
    PUBLISHED.iter().filter(fits).find_map(|found| {
        let &rate = found.anchors.get(&config.method)?;
        Some(Success { rate, source: found.source(config) })
    })
}

/// The keys in which the authors' settings differ; a panel that does not set one has its task's default.
const SETTINGS: [&str; 4] = [
    "environment.coverage",
    "environment.noise",
    "demonstrations.coverage",
    "demonstrations.noise",
];

impl Published {
    fn of(Panel { name: panel, task, set, anchors }: Panel) -> Published {
        let setting = |text: &String| flat(&parse_setting(text).expect("a test reads the plans"));
        let own = tasks::configuration(&task, None, &[]).expect("a test reads the plans");
        let mut settings = flat(&Table::try_from(own).expect("a configuration is a table"));
        settings.retain(|key, _| SETTINGS.contains(&key.as_str()));
        settings.extend(set.iter().flat_map(setting));
        Published { panel, task, settings, anchors }
    }

    fn source(&self, config: &RunConfig) -> &'static str {
        if self.panel == QUOTED {
            return "for \"more than 80 %\" in the paper's text";
        }
        match config.task.observation {
            ObservationSpec::Cells { .. } => "the end of their curve after 4.9 million steps",
            ObservationSpec::Vector { .. } => {
                "the end of their curve after 4.9 million steps in MuJoCo"
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn published(task: &str, settings: &[&str]) -> Option<Success> {
        let settings: Vec<String> = settings.iter().map(|&text| text.to_owned()).collect();
        success(&tasks::configuration(task, None, &settings).unwrap())
    }

    #[test]
    fn the_rate_is_that_of_task_method_and_setting() {
        let of = |task, settings: &[&str]| published(task, settings).map(|found| found.rate);
        assert_eq!(of("navigation", &["demonstrations.coverage=0.5"]), Some(0.98));
        assert_eq!(of("navigation", &["demonstrations.coverage=0.25", "method=bc"]), Some(0.56));
        assert_eq!(of("navigation", &["demonstrations.coverage=0.3"]), None);
        assert_eq!(of("fetch-push", &["environment.noise=2.0", "method=gaifo"]), Some(0.23));
        assert_eq!(of("fetch-push", &["environment.noise=2.0", "method=segment-matching"]), None);
        // There are curves for this noise and for this coverage, but none for the two together.
        assert_eq!(of("fetch-pick", &["demonstrations.coverage=0.5"]), Some(0.8));
        let both = ["demonstrations.coverage=0.5", "environment.noise=2.0"];
        assert_eq!(of("fetch-pick", &both), None);
        assert_eq!(of("fetch-push", &["demonstrations.coverage=0.25"]), None);
        let ant = ["environment.noise=0.05", "method=difference"];
        assert_eq!(of("ant-reach", &ant), Some(0.34));
        // These are only in Figures 6 and 12.
        let half = ["demonstrations.coverage=0.5", "method=difference"];
        assert_eq!(of("navigation", &half), Some(0.98));
        assert_eq!(of("fetch-push", &["environment.noise=2.0", "method=sqil"]), Some(0.01));
    }

    #[test]
    fn the_source_says_mujoco_only_of_physics_and_curve_only_of_a_curve() {
        let source = |task, setting| published(task, &[setting]).unwrap().source;
        assert!(source("fetch-push", "environment.noise=2.0").ends_with("in MuJoCo"));
        let half = "demonstrations.coverage=0.5";
        assert!(source("navigation", half).ends_with("million steps"));
        assert!(source("fetch-pick", half).contains("more than 80 %"));
    }

    #[test]
    fn every_anchor_of_every_plan_is_known_and_the_same_in_all_of_them() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../experiments");
        for file in std::fs::read_dir(folder).unwrap() {
            let text = std::fs::read_to_string(file.unwrap().path()).unwrap();
            let plan: Plan = toml::from_str(&text).unwrap();
            for Published { panel, task, settings, anchors } in
                plan.panel.into_iter().map(Published::of)
            {
                let is_same = |other: &&Published| other.task == task && other.settings == settings;
                for (method, rate) in &anchors {
                    let same = PUBLISHED.iter().filter(is_same);
                    let known: Vec<&f64> =
                        same.filter_map(|other| other.anchors.get(method)).collect();
                    let agree = !known.is_empty() && known.iter().all(|&other| other == rate);
                    assert!(agree, "{panel}, {method}: {rate} is not among {known:?}");
                }
            }
        }
    }
}
