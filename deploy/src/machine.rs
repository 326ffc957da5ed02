//! Compares what a run is estimated to need with the machine that is to train it. A run that cannot fit, or would never
//! end, is refused before it is laid out.

use std::fs;

use anyhow::{Result, ensure};
use run::config::{Estimate, RunConfig};

use terminal::numbers;
use terminal::refusal::wrong_usage;

/// Most threads of a process per core. More would only wait for each other.
const THREADS_PER_CORE: usize = 4;

/// Most actors per core: some wait for leases while others act.
const ACTORS_PER_CORE: u64 = 8;

/// Most rows that pass through networks: weeks on two cores, at a few hundred thousand rows a second.
const MOST_ROW_PASSES: f64 = 1e12;

/// Most environment steps: eleven days, at 100,000 steps a second.
const MOST_ENVIRONMENT_STEPS: f64 = 1e11;

/// Fraction of these limits above which a run is called long.
const LONG: f64 = 1e-2;

/// The resources of a machine.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Machine {
    cores: usize,
    /// Available memory, bytes; `None` if the system does not say.
    memory: Option<f64>,
}

impl Machine {
    /// Returns the resources of this machine.
    pub(crate) fn here() -> Machine {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let available = fs::read_to_string("/proc/meminfo").ok().and_then(|text| available(&text));
        // A container may be granted less memory than the machine has.
        let granted = fs::read_to_string("/sys/fs/cgroup/memory.max").ok();
        let granted = granted.and_then(|text| text.trim().parse::<f64>().ok());
        let memory = available.into_iter().chain(granted).reduce(f64::min);
        Machine { cores, memory }
    }

    /// Refuses more actors than the machine can usefully run. `asked_by` is the flag or setting that asks for them.
    ///
    /// # Errors
    /// Wrong usage, stating what the machine has.
    pub(crate) fn require_room_for_actors(&self, asked_by: &str, actors: u64) -> Result<()> {
        let most = ACTORS_PER_CORE * self.cores as u64;
        self.require(asked_by, actors, most, ACTORS_PER_CORE)
    }

    /// Refuses a run that the machine cannot train. Returns a remark about a run that takes long.
    ///
    /// # Errors
    /// Wrong usage, stating the size and what the machine has.
    pub(crate) fn require_room_for(&self, config: &RunConfig) -> Result<Option<String>> {
        let resources = &config.resources;
        let setting = |key: &str| format!("configuration: `resources.{key}`");
        self.require_room_for_actors(&setting("actors"), resources.actors)?;
        for (key, threads) in [
            ("learner_threads", resources.learner_threads),
            ("service_threads", resources.service_threads),
        ] {
            let most = THREADS_PER_CORE * self.cores;
            self.require(&setting(key), threads as u64, most as u64, THREADS_PER_CORE as u64)?;
        }
        let estimate = config.estimate(self.cores);
        if let Some(memory) = self.memory.filter(|&memory| estimate.bytes() > memory) {
            return Err(wrong_usage(words_of_memory(&estimate, memory)));
        }
        let Estimate { environment_steps, row_passes, .. } = estimate;
        require_end(environment_steps, row_passes)?;
        let is_long = environment_steps > LONG * MOST_ENVIRONMENT_STEPS
            || row_passes > LONG * MOST_ROW_PASSES;
        Ok(is_long.then(|| words_of_work(&estimate)))
    }

    fn require(&self, asked_by: &str, found: u64, most: u64, each: u64) -> Result<()> {
        let expected = format!("expected at most {most}, {each} for each core of {}", self.cores);
        ensure!(found <= most, wrong_usage(format!("{asked_by}: {expected}, found {found}")));
        Ok(())
    }
}

/// Refuses work that would never end.
///
/// # Errors
/// Wrong usage, stating the size.
pub(crate) fn require_end(environment_steps: f64, row_passes: f64) -> Result<()> {
    for (what, found, most) in [
        ("environment steps", environment_steps, MOST_ENVIRONMENT_STEPS),
        ("rows to pass through networks", row_passes, MOST_ROW_PASSES),
    ] {
        if found > most {
            return Err(wrong_usage(format!(
                "this would take too long: expected at most {most:e} {what}, found about {found:.1e}"
            )));
        }
    }
    Ok(())
}

fn words_of_memory(estimate: &Estimate, memory: f64) -> String {
    let Estimate { learner_bytes, service_bytes, actor_bytes, actors, .. } = *estimate;
    let shown = |bytes: f64| numbers::bytes(bytes as u64);
    format!(
        "not enough memory: the run needs about {} (learner {}, service {}, {actors} actors with \
         {} each), found {} available",
        shown(estimate.bytes()),
        shown(learner_bytes),
        shown(service_bytes),
        shown(actor_bytes),
        shown(memory)
    )
}

fn words_of_work(estimate: &Estimate) -> String {
    let count = |number: f64| numbers::count(number as u64);
    format!(
        "this will take long: about {} environment steps, {} optimizer steps, {} rows through networks",
        count(estimate.environment_steps),
        count(estimate.gradient_steps),
        count(estimate.row_passes)
    )
}

/// Parses `MemAvailable` of `/proc/meminfo`, bytes.
fn available(text: &str) -> Option<f64> {
    let line = text.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    Some(line.trim().strip_suffix("kB")?.trim().parse::<f64>().ok()? * 1024.0)
}

#[cfg(test)]
mod tests {

    use super::*;
    use run::tasks::configuration;

    const SMALL: Machine = Machine { cores: 2, memory: Some(16e9) };

    fn judged(task: &str, settings: &str) -> Result<Option<String>, String> {
        let settings: Vec<String> = settings.split_whitespace().map(str::to_owned).collect();
        let config = configuration(task, None, &settings).unwrap();
        SMALL.require_room_for(&config).map_err(|error| error.to_string())
    }

    #[test]
    fn what_a_task_is_by_itself_fits() {
        for task in ["navigation", "fetch-pick", "fetch-push", "ant-reach"] {
            for method in ["goal-proximity", "ranking", "gail", "bc", "bco", "sqil"] {
                assert_eq!(judged(task, &format!("method={method}")), Ok(None), "{task} {method}");
            }
        }
    }

    /// 481 MiB were measured with four actors.
    #[test]
    fn the_default_run_takes_about_what_was_measured() {
        let config =
            configuration("navigation", Some("authors"), &["resources.actors=4".to_owned()]);
        let mib = config.unwrap().estimate(2).bytes() / f64::from(1 << 20);
        assert!((350.0..650.0).contains(&mib), "{mib} MiB");
    }

    #[test]
    fn what_the_machine_has_not_is_refused_with_the_figure() {
        for (task, settings, words) in [
            ("navigation", "policy.features=1000000", &["GiB", "found 14.9 GiB available"][..]),
            ("navigation", "reward.hidden=[1000000,1000000]", &["TiB", "service"]),
            ("fetch-push", "policy.hidden=[9000000000000000000,9000000000000000000]", &["TiB"]),
            ("navigation", "reward.experience=1000000000000", &["TiB", "service"]),
            ("navigation", "demonstrations.episodes=1000000000000", &["TiB"]),
            ("navigation", "rollout.lane_steps=1000000000000", &["TiB", "learner"]),
            ("navigation", "method=bco inverse_dynamics.features=1000000", &["learner"]),
            ("fetch-push", "method=sqil sqil.hidden=[100000,100000]", &["learner"]),
            ("navigation", "reward.pretraining_epochs=1000000000", &["TiB", "service"]),
            ("navigation", "resources.learner_threads=100000", &["at most 8", "100000"]),
            ("navigation", "resources.service_threads=9", &["at most 8", "found 9"]),
            ("navigation", "resources.actors=17", &["`resources.actors`", "at most 16"]),
            ("navigation", "ppo.epochs=1000000000", &["take too long", "1.5e15"]),
            ("navigation", "method=bc cloning.epochs=1000000000", &["take too long", "rows"]),
            ("navigation", "evaluation.episodes=10000000000", &["take too long", "1.0e12"]),
            ("navigation", "steps=9000000000000000000", &["take too long"]),
            ("fetch-push", "method=sqil sqil.updates_per_step=1e12", &["take too long"]),
        ] {
            let said = judged(task, settings).expect_err(settings);
            for word in words {
                assert!(said.contains(word), "{settings}: expected `{word}` in {said}");
            }
            assert!(!said.contains('\n'), "{said}");
        }
    }

    #[test]
    fn what_takes_long_is_said() {
        let said = judged("navigation", "evaluation.episodes=100000000").unwrap().unwrap();
        assert!(said.contains("about 10,001,525,250 environment steps"), "{said}");
        let said = judged("navigation", "ppo.epochs=10000").unwrap().unwrap();
        assert!(said.contains("rows through networks"), "{said}");
    }

    #[test]
    fn available_memory_is_read() {
        let text = "MemTotal:  24684532 kB\nMemFree: 1 kB\nMemAvailable:   2048 kB\n";
        assert_eq!(available(text), Some(2048.0 * 1024.0));
        assert_eq!(available("MemAvailable: many\n"), None);
        assert!(Machine::here().cores >= 1);
    }
}
