//! The end of the authors' published curve for a run's method, task and setting.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use protocol::table::{flat, parse_setting};
use run::config::RunConfig;
use run::tasks;
use serde::Deserialize;
use toml::{Table, Value};

/// The plans whose panels have curves of their own; other figures repeat these.
const PLANS: [&str; 4] = [
    include_str!("../../experiments/figure3.toml"),
    include_str!("../../experiments/figure4.toml"),
    include_str!("../../experiments/figure8.toml"),
    include_str!("../../experiments/figure9.toml"),
];

/// The part of a plan that matters here.
#[derive(Deserialize)]
struct Plan {
    panel: Vec<Panel>,
}

#[derive(Deserialize)]
struct Panel {
    task: String,
    #[serde(default)]
    set: Vec<String>,
    #[serde(default)]
    anchors: BTreeMap<String, f64>,
}

/// Final success rates of the published curves of a panel, by method, and the settings that they are for.
struct Published {
    task: String,
    settings: BTreeMap<String, Value>,
    anchors: BTreeMap<String, f64>,
}

static PUBLISHED: LazyLock<Vec<Published>> = LazyLock::new(|| {
    let plans = PLANS.iter().map(|plan| toml::from_str(plan).expect("a test reads the plans"));
    plans.flat_map(|plan: Plan| plan.panel).map(Published::of).collect()
});

/// Returns the success rate at the end of the authors' curve of a run's method, after 4.9 million steps. Returns
/// `None` if no curve is published for the run's task and setting.
pub(crate) fn success_rate(config: &RunConfig) -> Option<f64> {
    let values = flat(&Table::try_from(config).ok()?);
    let fits = |published: &&Published| {
        let holds = |(key, value): (&String, &Value)| values.get(key) == Some(value);
        published.task == config.task.name && published.settings.iter().all(holds)
    };
    PUBLISHED.iter().filter(fits).find_map(|found| found.anchors.get(&config.method).copied())
}

/// The keys in which the authors' settings differ; a panel that does not set one has its task's default.
const SETTINGS: [&str; 4] = [
    "environment.coverage",
    "environment.noise",
    "demonstrations.coverage",
    "demonstrations.noise",
];

impl Published {
    fn of(Panel { task, set, anchors }: Panel) -> Published {
        let setting = |text: &String| flat(&parse_setting(text).expect("a test reads the plans"));
        let own = tasks::configuration(&task, None, &[]).expect("a test reads the plans");
        let mut settings = flat(&Table::try_from(own).expect("a configuration is a table"));
        settings.retain(|key, _| SETTINGS.contains(&key.as_str()));
        settings.extend(set.iter().flat_map(setting));
        Published { task, settings, anchors }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_curve_is_that_of_task_method_and_setting() {
        let of = |task, settings: &[&str]| {
            let settings: Vec<String> = settings.iter().map(|&text| text.to_owned()).collect();
            success_rate(&tasks::configuration(task, None, &settings).unwrap())
        };
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
    }
}
