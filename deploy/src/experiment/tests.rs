//! Tests of plans: those of the paper's figures are valid, others are refused with a reason, and a run is identified by
//! what decides its result.

use std::fs;
use std::path::{Path, PathBuf};

use proptest::test_runner::{Config, RngAlgorithm, TestRng, TestRunner};
use protocol::setting::Setting;
use toml::Value;

use super::*;
use file::PlanFile;
use planned_run::PlannedRun;

/// The damaged inputs that every reader of foreign bytes is tested with.
#[path = "../../../tests/fuzz/damage.rs"]
mod damage;

/// A valid plan, from which tests make invalid ones.
const PLAN: &str = r#"
title = "A comparison"
seeds = [1, 2]
methods = ["goal-proximity", "no-final"]
set = ["evaluation.episodes=500"]

[[panel]]
name = "half"
title = "NAVIGATION"
task = "navigation"
set = ["demonstrations.coverage=0.5"]
anchors = { goal-proximity = 0.9 }

[[panel.curve]]
name = "lambda 1"
method = "goal-proximity"
set = ["reward.uncertainty=1.0"]

[[panel]]
name = "reference"
title = "FETCH PUSH"
task = "fetch-push"
steps = 9000
methods = ["environment-reward"]

[quick]
steps = 5000
seeds = [7]
panels = ["half"]
set = ["evaluation.episodes=5"]

[quick.method]
no-final = ["reward.pretraining_epochs=1"]
"#;

fn write(directory: &Path, text: &str) -> PathBuf {
    let path = directory.join("figure.toml");
    fs::write(&path, text).unwrap();
    path
}

fn runs(text: &str, quick: bool) -> Vec<PlannedRun> {
    let directory = tempfile::tempdir().unwrap();
    let plans = read_all(&[write(directory.path(), text)], quick).unwrap();
    queue(&plans, &mut Archive::open(directory.path()))
}

#[test]
fn a_plan_is_every_run_once() {
    let all = runs(PLAN, false);
    // The method without the final bonus is the default, so it is the same run.
    let shown: Vec<_> = all.iter().map(|run| (run.config.seed, &run.config.method)).collect();
    let [ours, reference] = ["goal-proximity", "environment-reward"].map(str::to_owned);
    let first = [(1, &ours), (1, &ours), (1, &reference)];
    assert_eq!((shown.len(), &shown[..3]), (6, &first[..]));
    assert!(shown[3..].iter().all(|(seed, _)| *seed == 2), "the first seed of all comes first");
    let configs: Vec<_> = all.iter().map(|run| &run.config).collect();
    assert_eq!(configs.iter().map(|config| config.steps).max(), Some(1_500_000));
    assert_eq!((configs[1].reward.uncertainty, configs[2].steps), (1.0, 9000));
    assert!(configs.iter().all(|config| config.evaluation.episodes == 500));
    let half = Setting("coverage = 0.5".parse().unwrap());
    assert!(configs[..2].iter().all(|config| config.demonstrations.environment == half));
}

#[test]
fn a_curve_has_its_own_preset_or_its_panels() {
    let of_the_panel = PLAN.replace("name = \"half\"", "name = \"half\"\npreset = \"paper\"");
    let own = "name = \"lambda 1\"\npreset = \"authors\"";
    let all = runs(&of_the_panel.replace("name = \"lambda 1\"", own), false);
    let presets: Vec<_> = all.iter().map(|run| &run.config.preset).collect();
    // With the paper's final bonus, the method without it is a run of its own.
    assert_eq!(presets[..4], ["paper", "paper", "authors", "goalward"]);
    assert_eq!((all[0].config.steps, all[1].config.reward.final_bonus), (3_000_000, false));
}

#[test]
fn a_quick_plan_is_small() {
    let all = runs(PLAN, true);
    let shown: Vec<_> = all.iter().map(|run| &run.config).collect();
    assert_eq!(shown.len(), 3, "fewer passes of offline training make it another run");
    assert!(shown.iter().all(|config| (config.seed, config.steps) == (7, 5000)));
    assert!(shown.iter().all(|config| config.evaluation.episodes == 5));
    assert_eq!(shown[1].reward.pretraining_epochs, 1);
}

#[test]
fn a_run_that_is_there_is_found_under_any_name() {
    let all = runs(PLAN, false);
    let directory = tempfile::tempdir().unwrap();
    let name = Archive::open(directory.path()).name_of(&all[0]);
    assert!(name.starts_with("navigation-goal-proximity-s1-"), "{name}");
    let other = name.replace("goal-proximity", "no-final");
    fs::create_dir_all(directory.path().join("runs").join(&other)).unwrap();
    fs::write(directory.path().join(format!("runs/{other}.txt")), "").unwrap();
    assert_eq!(Archive::open(directory.path()).name_of(&all[0]), other);
}

#[test]
fn demonstrations_are_shared_where_they_are_the_same() {
    let all = runs(PLAN, false);
    let archive = Archive::open(Path::new("e"));
    let file = |run: &PlannedRun| archive.demonstrations_of(&run.config);
    assert_eq!(file(&all[0]), file(&all[1]));
    assert_ne!(file(&all[0]), file(&all[3]), "another seed");
    let mut noisy = all[2].clone();
    noisy.config.environment.0.insert("noise".to_owned(), Value::Float(1.5));
    assert_eq!(file(&all[2]), file(&noisy), "the agent's noise is not the expert's");
    let expert = &mut noisy.config.demonstrations.environment.0;
    expert.insert("coverage".to_owned(), Value::Float(0.5));
    assert_ne!(file(&all[2]), file(&noisy));
}

/// Writes the file of a user's own task, and a plan with a panel on it; returns the plan's path.
fn plan_of_own_task(folder: &Path) -> PathBuf {
    fs::create_dir_all(folder.join("target/release")).unwrap();
    let task = folder.join("reacher.toml");
    fs::write(&task, include_str!("../../examples/reacher/reacher.toml")).unwrap();
    let own = format!("task = {:?}", task.to_str().unwrap());
    let text = PLAN.replace("task = \"fetch-push\"", &own);
    assert_ne!(text, PLAN);
    write(folder, &text.replace("methods = [\"environment-reward\"]", ""))
}

#[test]
fn a_program_that_was_built_anew_makes_other_runs_and_demonstrations() {
    let directory = tempfile::tempdir().unwrap();
    let folder = directory.path();
    let (plan, program) = (plan_of_own_task(folder), folder.join("target/release/reacher"));
    let missing = Plan::read(&plan, false).unwrap_err().to_string();
    for part in ["figure.toml", "panel reference", "target/release/reacher of reacher"] {
        assert!(missing.contains(part) && !missing.contains('\n'), "{missing}");
    }
    let names = |build: &str| {
        fs::write(&program, build).unwrap();
        let mut archive = Archive::open(folder);
        let runs = queue(&read_all(&[&plan], false).unwrap(), &mut archive);
        let name = |run: &PlannedRun| {
            (
                run.config.task.name.clone(),
                archive.name_of(run),
                archive.demonstrations_of(&run.config),
            )
        };
        runs.iter().map(name).collect::<Vec<_>>()
    };
    let [before, again, anew] = ["one", "one", "other"].map(names);
    assert_eq!(before, again);
    assert_eq!(before.len(), anew.len());
    for ((task, run, demonstrations), (_, new_run, new_demonstrations)) in before.iter().zip(&anew)
    {
        let is_own = task == "reacher";
        assert_eq!(
            (run != new_run, demonstrations != new_demonstrations),
            (is_own, is_own),
            "{run}"
        );
    }
    assert!(before.iter().any(|(task, ..)| task == "reacher"));
}

/// Recorded results are stored under these names.
#[test]
fn a_task_of_ours_has_the_names_it_always_had() {
    let run = &runs(PLAN, false)[2];
    assert_eq!((&run.config.task.program, &run.config.task.program_sha256), (&None, &None));
    let setting = serde_json::to_string(&run.config.demonstration_setting()).unwrap();
    let hash = format!("{:08x}", xxhash_rust::xxh3::xxh3_64(setting.as_bytes()) >> 32);
    let file = Archive::open(Path::new("e")).demonstrations_of(&run.config);
    assert!(file.to_str().unwrap().ends_with(&format!("-s1-{hash}.mcap")), "{}", file.display());
}

#[test]
fn what_is_wrong_is_named() {
    let directory = tempfile::tempdir().unwrap();
    for (sound, spoilt, parts) in [
        ("seeds = [1, 2]", "seeds = [1, 1]", &["panel half", "seed", "1 again"][..]),
        ("seeds = [1, 2]", "seeds = []", &["expected a seed, found none"]),
        ("title = \"A", "colour = 1\ntitle = \"A", &["line 2", "colour"]),
        ("title = \"A comparison\"", "", &["title"]),
        ("\"no-final\"]", "\"magic\"]", &["panel half", "curve magic", "method", "gaifo-s"]),
        ("\"no-final\"]", "\"lambda 1\"]", &["panel half", "curve once", "lambda 1 again"]),
        ("task = \"navigation\"", "task = \"chess\"", &["panel half", "chess", "navigation"]),
        (
            "title = \"NAVIGATION\"",
            "title = \"N\"\npreset = \"best\"",
            &["panel half", "best", "authors"],
        ),
        ("uncertainty=1.0", "uncertainty=-1.0", &["panel half", "curve lambda 1", "uncertainty"]),
        ("reward.uncertainty=1.0", "seed=5", &["curve lambda 1", "neither method nor seed"]),
        ("reward.uncertainty=1.0", "wings=5", &["curve lambda 1", "wings"]),
        ("name = \"reference\"", "name = \"half\"", &["every panel once", "half again"]),
        ("name = \"reference\"", "name = \"a/b\"", &["panel \"a/b\"", "letters"]),
        ("panels = [\"half\"]", "panels = [\"whole\"]", &["quick", "no panel whole"]),
        ("no-final = [\"r", "gail = [\"r", &["quick", "no curve of the method gail"]),
        ("{ goal-proximity = 0.9 }", "{ gail = 0.9 }", &["panel half", "anchors", "gail"]),
        ("{ goal-proximity = 0.9 }", "{ goal-proximity = 90 }", &["goal-proximity", "[0, 1]"]),
    ] {
        let text = PLAN.replace(sound, spoilt);
        assert_ne!(text, PLAN, "{sound}");
        let error = Plan::read(&write(directory.path(), &text), false).unwrap_err().to_string();
        for part in parts.iter().chain(&["figure.toml"]) {
            assert!(error.contains(part) && !error.contains('\n'), "{spoilt}: {error}");
        }
    }
    let missing = Plan::read(Path::new("nowhere.toml"), false).unwrap_err().to_string();
    assert!(missing.contains("nowhere.toml"), "{missing}");
    let same = vec![write(directory.path(), PLAN); 2];
    assert!(read_all(&same, false).unwrap_err().to_string().contains("another plan is called"));
}

/// Returns the plans that come with Goalward, those of figures first.
fn figures() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("experiments");
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut plans: Vec<_> = entries.collect();
    plans.sort();
    plans
}

#[test]
fn the_plans_of_the_figures_are_sound() {
    let plans = read_all(&figures(), false).unwrap();
    let mut archive = Archive::open(Path::new("e"));
    let names: Vec<_> = plans.iter().map(|plan| plan.figure(&mut archive).name).collect();
    let numbers = [11, 12, 3, 4, 5, 6, 7, 8, 9].map(|number| format!("figure{number}"));
    assert_eq!(
        (&names[..9], &names[9..]),
        (
            &numbers[..],
            &["next-state", "no-online", "no-termination", "paper"].map(str::to_owned)[..]
        )
    );
    let of_figures = &plans[..9];
    let asked = of_figures.iter().flat_map(Plan::runs).count();
    let trained = queue(of_figures, &mut archive).len();
    assert!(trained * 5 < asked * 4, "figures share runs: {trained} for {asked}");
}

/// The quick plans of the figures must be done within an hour on two cores, including build and report.
#[test]
fn all_quick_plans_together_are_small() {
    let plans = read_all(&figures()[..9], true).unwrap();
    let runs = queue(&plans, &mut Archive::open(Path::new("e")));
    assert!((60..=100).contains(&runs.len()), "{} runs", runs.len());
    assert!(runs.iter().all(|run| run.config.steps <= 60_000));
}

/// Gives damaged plans to a reader, which must accept them or say why not in one line.
fn fuzz(cases: u32, read: impl Fn(&Path) -> anyhow::Result<()>) {
    let directory = tempfile::tempdir().unwrap();
    let stream = TestRng::deterministic_rng(RngAlgorithm::ChaCha);
    let config = Config { cases, failure_persistence: None, ..Config::default() };
    let mut runner = TestRunner::new_with_rng(config, stream);
    let tried = runner.run(&damage::inputs(vec![PLAN.as_bytes().to_vec()]), |bytes| {
        let path = directory.path().join("figure.toml");
        fs::write(&path, bytes).unwrap();
        if let Err(error) = read(&path) {
            let line = format!("{error:#}");
            assert!(line.len() < 4_000 && !line.chars().any(char::is_control), "{line:?}");
        }
        Ok(())
    });
    if let Err(failure) = tried {
        panic!("{failure}");
    }
}

#[test]
fn any_bytes_are_a_plan_or_a_line() {
    let cases = std::env::var("GOALWARD_FUZZ_CASES").map_or(10_000, |cases| cases.parse().unwrap());
    fuzz(cases, |path| PlanFile::read(path).map(drop));
    // `Plan::read` assembles every run of a plan, which takes a while.
    fuzz(cases / 50, |path| Plan::read(path, true).map(drop));
}
