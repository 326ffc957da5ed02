//! Groups folders of runs into a figure: a panel for each task, and in it a curve for each method and setting. Runs
//! that differ only in their seeds share a curve.

use std::collections::{BTreeMap, BTreeSet};

use anyhow::Result;
use protocol::task::Task;
use run::config::RunConfig;
use run::folder::RunFolder;

use crate::figure::{Curve, Figure, Panel};
use crate::measured::Measured;
use run::repeat::{changes, is_of_ours, settings, unquoted};
use run::tasks::place;
use terminal::print::print_remark;
use terminal::refusal::wrong_usage;

/// Keys in which runs of one curve may differ.
pub const OF_NO_CURVE: [&str; 2] = ["demonstrations.file", "evaluation.episodes"];

/// Descriptions of a run apart from its task and method: preset, number of steps, settings.
type Phrases = BTreeSet<String>;

/// A run with its method and its other descriptions.
type Described = (RunFolder, String, Phrases);

/// A run and its configuration.
type Configured = (RunFolder, RunConfig);

/// Groups runs into a figure. Runs without a policy update are left out with a remark.
///
/// # Errors
/// A usage error for the first folder that is no run or whose log cannot be read, or when no run has a policy update.
pub(crate) fn figure(folders: Vec<RunFolder>) -> Result<Figure> {
    let mut tasks: Vec<(Task, Vec<Configured>)> = Vec::new();
    let mut left_out = Vec::new();
    for folder in folders {
        let Some(Measured { config, .. }) = Measured::if_it_learned(folder.clone())? else {
            left_out.push(lack(&folder));
            continue;
        };
        match tasks.iter_mut().find(|(known, _)| *known == config.task) {
            Some((_, runs)) => runs.push((folder, config)),
            None => tasks.push((config.task.clone(), vec![(folder, config)])),
        }
    }
    if let (true, Some(first)) = (tasks.is_empty(), left_out.first()) {
        return Err(wrong_usage(format!(
            "nothing to report on: expected runs with policy updates, found {} without, such as \
             {first}",
            left_out.len()
        )));
    }
    left_out.iter().for_each(|run| print_remark(&format!("left out: {run}")));
    tasks.sort_by_key(|(task, _)| place(&task.name));
    let mut panels: Vec<Panel> = Vec::new();
    for (task, runs) in tasks {
        let panel = panel(task, described(runs));
        panels.push(Panel { name: free_name(&panel.name, &panels), ..panel });
    }
    Ok(Figure { name: "runs".to_owned(), title: "Runs".to_owned(), panels })
}

/// Names a run without a policy update, and says what it lacks.
fn lack(folder: &RunFolder) -> String {
    let what = if folder.log().exists() { "no policy update yet" } else { "not begun" };
    format!("{}: {what}", folder.path().display())
}

/// Refuses a curve that has two runs of one seed: they would count as two.
///
/// # Errors
/// A usage error that names the two, or if a configuration cannot be read.
pub(crate) fn refuse_seed_twice(figure: &Figure) -> Result<()> {
    for curve in figure.panels.iter().flat_map(|panel| &panel.curves) {
        let mut runs: BTreeMap<u64, &RunFolder> = BTreeMap::new();
        for run in &curve.runs {
            let seed = run.config()?.seed;
            if let Some(other) = runs.insert(seed, run) {
                let [one, other] = [other, run].map(|run| run.path().display());
                return Err(wrong_usage(format!(
                    "curve {}: expected every seed once, found seed {seed} in {one} and {other}",
                    curve.name
                )));
            }
        }
    }
    Ok(())
}

/// Returns the name, with a number if a panel already has it: tasks of the same name may differ in shapes or programs.
fn free_name(name: &str, panels: &[Panel]) -> String {
    let is_free = |name: &String| panels.iter().all(|panel| panel.name != *name);
    let numbered = (2..).map(|number| format!("{name}-{number}"));
    let mut names = std::iter::once(name.to_owned()).chain(numbered);
    names.find(is_free).expect("numbers do not end")
}

/// Describes the runs of a task.
fn described(runs: Vec<Configured>) -> Vec<Described> {
    let configs: Vec<RunConfig> = runs.iter().map(|(_, config)| config.clone()).collect();
    let described = runs.into_iter().map(|(folder, config)| {
        let settings =
            if is_of_ours(&config) { settings(&config) } else { differing(&config, &configs) };
        let settings = settings.into_iter().filter(|(key, _)| !OF_NO_CURVE.contains(&&**key));
        let mut phrases: Phrases = settings.map(|(key, value)| format!("{key}={value}")).collect();
        phrases.insert(format!("preset {}", config.preset));
        phrases.insert(format!("{} steps", terminal::numbers::count(config.steps)));
        (folder, config.method, phrases)
    });
    described.collect()
}

/// Returns those settings of a run, as keys and values, in which the runs of its method differ. Used for tasks that do
/// not come with Goalward: their defaults are not known.
fn differing(config: &RunConfig, all: &[RunConfig]) -> Vec<(String, String)> {
    let of_method = || all.iter().filter(|one| one.method == config.method);
    let first = of_method().next().unwrap_or(config);
    let mut values = BTreeMap::new();
    for change in of_method().flat_map(|one| changes(one, first)) {
        values.insert(change.key, change.default);
    }
    values.extend(changes(config, first).into_iter().map(|change| (change.key, change.value)));
    values.into_iter().map(|(key, value)| (key, unquoted(&value))).collect()
}

/// Returns a panel. Its title has the phrases that all runs share; the names of curves have the others.
fn panel(task: Task, runs: Vec<Described>) -> Panel {
    let sets = || runs.iter().map(|(.., phrases)| phrases);
    let is_common = |phrase: &&String| sets().all(|phrases| phrases.contains(*phrase));
    let common: Phrases = sets().next().into_iter().flatten().filter(is_common).cloned().collect();
    let methods: BTreeSet<&str> = runs.iter().map(|(_, method, _)| method.as_str()).collect();
    let mut curves: Vec<Curve> = Vec::new();
    for (folder, method, phrases) in &runs {
        let mut own: Vec<&str> = phrases.difference(&common).map(String::as_str).collect();
        if own.is_empty() || methods.len() > 1 {
            own.insert(0, method);
        }
        let name = own.join(", ");
        match curves.iter_mut().find(|curve| curve.name == name) {
            Some(curve) => curve.runs.push(folder.clone()),
            None => curves.push(Curve { name, runs: vec![folder.clone()], anchor: None }),
        }
    }
    let common: Vec<String> = common.into_iter().collect();
    let title = format!("{}: {}", task.name.to_uppercase().replace('-', " "), common.join(", "));
    Panel { name: task.name.clone(), title, task, curves }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::Path;

    use mcap_log::{Kind, LogOptions, LogWriter, Metadata};
    use protocol::messages::PolicyUpdate;

    use super::*;
    use run::tasks::configuration;

    fn laid_out(path: &Path, seed: u64) -> RunFolder {
        let folder = RunFolder::new(path);
        fs::create_dir_all(path).unwrap();
        let config = configuration("navigation", None, &[format!("seed={seed}")]).unwrap();
        fs::write(folder.config_file(), config.to_text()).unwrap();
        folder
    }

    fn with_log(folder: RunFolder, updates: u64) -> RunFolder {
        let config = folder.config().unwrap();
        let metadata = Metadata::new(Kind::Run, &config.task.name, config.seed);
        let mut log = LogWriter::create(&folder.log(), &metadata, LogOptions::default()).unwrap();
        for iteration in 0..updates {
            log.policy_update(&PolicyUpdate { iteration, ..PolicyUpdate::default() }).unwrap();
        }
        log.finish().unwrap();
        folder
    }

    #[test]
    fn runs_that_have_not_learned_are_left_out_unless_nothing_remains() {
        let directory = tempfile::tempdir().unwrap();
        let place = |name: &str| directory.path().join(name);
        let interrupted = laid_out(&place("interrupted"), 1);
        let begun = with_log(laid_out(&place("begun"), 2), 0);
        let learned = with_log(laid_out(&place("learned"), 3), 2);
        let found = figure(vec![interrupted.clone(), begun.clone(), learned.clone()]).unwrap();
        assert_eq!(found.panels[0].curves[0].runs, [learned]);
        assert!(lack(&begun).ends_with("begun: no policy update yet"), "{}", lack(&begun));
        let refused = figure(vec![interrupted, begun]).err().unwrap().to_string();
        assert!(
            refused.contains("found 2 without") && refused.ends_with("interrupted: not begun"),
            "{refused}"
        );
        let refused = figure(vec![RunFolder::new(place("nowhere"))]).err().unwrap().to_string();
        assert!(refused.contains("nowhere"), "{refused}");
    }

    #[test]
    fn a_seed_counts_once_in_a_curve() {
        let directory = tempfile::tempdir().unwrap();
        let run =
            |(name, seed): (&str, u64)| with_log(laid_out(&directory.path().join(name), seed), 1);
        let [one, again, other] = [("m1", 1), ("m1again", 1), ("m2", 2)].map(run);
        let curves = figure(vec![one.clone(), other.clone()]).unwrap();
        refuse_seed_twice(&curves).unwrap();
        let curves = figure(vec![one, again, other]).unwrap();
        let refused = refuse_seed_twice(&curves).unwrap_err().to_string();
        assert!(refused.starts_with("curve goal-proximity: expected every seed once"), "{refused}");
        assert!(refused.contains("found seed 1 in") && refused.ends_with("m1again"), "{refused}");
    }

    #[test]
    fn panels_of_one_task_name_are_numbered() {
        let task = configuration("fetch-push", None, &[]).unwrap().task;
        let mut panels: Vec<Panel> = Vec::new();
        for expected in ["fetch-push", "fetch-push-2", "fetch-push-3"] {
            let name = free_name(&task.name, &panels);
            assert_eq!(name, expected);
            panels.push(Panel { name, ..panel(task.clone(), Vec::new()) });
        }
    }

    #[test]
    fn seeds_come_together_and_settings_apart() {
        let run = |name: &str, phrases: &[&str]| {
            let phrases = phrases.iter().map(|phrase| (*phrase).to_owned()).collect();
            (RunFolder::new(name), "goal-proximity".to_owned(), phrases)
        };
        let panel = panel(
            configuration("fetch-push", None, &[]).unwrap().task,
            vec![
                run("a", &["preset goalward"]),
                run("b", &["preset goalward", "reward.uncertainty=0.1"]),
                run("c", &["preset goalward"]),
            ],
        );
        assert_eq!(panel.title, "FETCH PUSH: preset goalward");
        let curves: Vec<_> =
            panel.curves.iter().map(|curve| (curve.name.as_str(), curve.runs.len())).collect();
        let expected = [("goal-proximity", 2), ("reward.uncertainty=0.1", 1)];
        assert_eq!(curves, expected);
    }

    #[test]
    fn runs_of_a_task_of_ones_own_are_told_apart_by_what_they_differ_in() {
        let run = |name: &str, set: &[&str]| {
            let set: Vec<String> = set.iter().map(|set| (*set).to_owned()).collect();
            let mut config = configuration("fetch-push", None, &set).unwrap();
            config.task.name = "own".to_owned();
            (RunFolder::new(name), config)
        };
        let runs = described(vec![
            run("a", &["seed=1"]),
            run("b", &["seed=2", "ppo.clip=0.3"]),
            run("c", &["seed=3", "method=gaifo"]),
            run("d", &["seed=4"]),
        ]);
        let curves = panel(run("a", &[]).1.task, runs).curves;
        let curves: Vec<_> =
            curves.iter().map(|curve| (curve.name.as_str(), curve.runs.len())).collect();
        let expected = [
            ("goal-proximity, ppo.clip=0.2", 2),
            ("goal-proximity, ppo.clip=0.3", 1),
            ("gaifo", 1),
        ];
        assert_eq!(curves, expected);
    }

    #[test]
    fn environments_of_other_modules_are_told_apart() {
        let run = |seed: u64, hash: &str| {
            let set = [format!("seed={seed}"), format!("environment.sources.track={hash}")];
            let mut config = configuration("fetch-push", None, &set).unwrap();
            config.task.name = "own".to_owned();
            (RunFolder::new(hash), config)
        };
        let runs = described(vec![run(1, "aa"), run(2, "aa"), run(3, "bb")]);
        let curves = panel(run(1, "aa").1.task, runs).curves;
        let curves: Vec<_> = curves.iter().map(|curve| curve.runs.len()).collect();
        assert_eq!(curves, [2, 1]);
    }
}
