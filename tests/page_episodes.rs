//! The episodes that the live page shows, of a log, of demonstrations and of evaluations, while a run trains and
//! after a process dies; and `goalward log scene`, which writes them for viewers.
//!
//! Method: the page's answers about real runs are compared with the log.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::collections::BTreeMap;
use std::time::Instant;

use mcap_log::{Contents, FileReader, Record, read_contents};
use serde_json::Value;
use system_tests::{Page, Signal, TestRun, programs};

/// Returns the rows of a table, each keyed by column name.
fn rows(page: &Page, path: &str) -> Vec<BTreeMap<String, Value>> {
    let found = page.json(path);
    let columns = found["columns"].as_array().unwrap().iter();
    let columns: Vec<&str> = columns.map(|column| column.as_str().unwrap()).collect();
    let row = |values: &Value| {
        let values = values.as_array().unwrap().iter().cloned();
        columns.iter().map(|column| (*column).to_owned()).zip(values).collect()
    };
    found["rows"].as_array().unwrap().iter().map(row).collect()
}

fn sum(numbers: &Value) -> f64 {
    numbers.as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).sum()
}

fn is_close(one: f64, other: f64) -> bool {
    (one - other).abs() < 1e-4
}

#[test]
fn every_episode_of_a_log_is_listed_and_shown() {
    let run = TestRun::new(programs!());
    let summary = run.train(&[]).finish();
    let page = Page::over(&run, &["."]);
    let all = rows(&page, "/api/runs/run/episodes/log");
    let of = |source: u64| all.iter().filter(move |row| row["source"] == source);
    assert_eq!(of(0).count() as u64, summary.episodes);
    assert_eq!(of(1).count() as u64, summary.evaluation.episodes);
    let steps: u64 = of(0).map(|row| row["steps"].as_u64().unwrap()).sum();
    assert_eq!(steps, summary.environment_steps);
    assert!(of(0).all(|row| row["return"].is_number() && row["uncertainty"].is_number()));
    assert!(of(1).all(|row| row["return"].is_null()));

    for place in [0, all.len() / 2, all.len() - 1] {
        let row = &all[place];
        let shown = page.json(&format!("/api/runs/run/episodes/log/{place}"));
        for column in ["iteration", "lane", "episode", "steps", "success", "steps_to_goal"] {
            assert_eq!(shown[column], row[column], "row {place}: {column}");
        }
        let steps = row["steps"].as_u64().unwrap() as usize;
        assert_eq!(shown["cells"].as_array().unwrap().len(), (steps + 1) * 19 * 19);
        assert_eq!(shown["actions"].as_array().unwrap().len(), steps);
        if row["source"] == 0 {
            assert_eq!(shown["proximity"].as_array().unwrap().len(), steps + 1);
            assert!(is_close(sum(&shown["rewards"]), row["return"].as_f64().unwrap()));
        }
        assert_eq!(page.json(&format!("/api/runs/run/episodes/log/{place}/scenes")), Value::Null);
    }
    let generation = page.json("/api/runs/run/episodes/log")["generation"].as_u64().unwrap();
    let from = page.json(&format!("/api/runs/run/episodes/log?from=5&generation={generation}"));
    assert_eq!(
        (from["from"].as_u64(), from["rows"].as_array().unwrap().len()),
        (Some(5), all.len() - 5)
    );
    let of_another_generation = page.json("/api/runs/run/episodes/log?from=5&generation=7");
    assert_eq!(of_another_generation["from"], 0);

    let demonstrations = rows(&page, "/api/runs/run/episodes/demonstrations");
    assert_eq!(demonstrations.len(), 40);
    assert!(demonstrations.iter().all(|row| row["source"] == 2 && row["success"] == true));
    for path in ["other", "..", "%2e%2e", "config.toml", "log/99999", "demonstrations/40/grid"] {
        let path = format!("/api/runs/run/episodes/{path}");
        page.refusal(404, &page.question("GET", &path, page.address()));
    }
}

#[test]
fn a_model_is_asked_about_a_grid_and_about_an_episode() {
    let run = TestRun::new(programs!());
    run.train(&[]).finish();
    let page = Page::over(&run, &["."]);
    let checkpoints = page.json("/api/runs/run")["checkpoints"].clone();
    assert_eq!(checkpoints.as_array().unwrap().len(), 5, "{checkpoints}");
    let grid = |checkpoint: &Value| {
        page.json(&format!("/api/runs/run/episodes/log/0/grid?checkpoint={checkpoint}"))
    };
    let [first, last] = [&checkpoints[0], &checkpoints[4]].map(grid);
    let places = first["places"].as_array().unwrap().len();
    assert!(places > 200 && first["proximity"].as_array().unwrap().len() == places);
    assert_ne!(first["proximity"], last["proximity"]);
    let said = page.json("/api/runs/run/episodes/demonstrations/0/proximity");
    let steps = page.json("/api/runs/run/episodes/demonstrations/0")["steps"].as_u64().unwrap();
    assert_eq!(said["proximity"].as_array().unwrap().len() as u64, steps + 1);
    let path = "/api/runs/run/episodes/log/0/grid?checkpoint=7";
    let line = page.refusal(404, &page.question("GET", path, page.address()));
    assert_eq!(line, "there is no checkpoint 7");
}

#[test]
fn an_episode_is_asked_what_another_reward_would_have_given() {
    let run = TestRun::new(programs!());
    run.train(&[]).finish();
    let page = Page::over(&run, &["."]);
    let path = |with: &str| format!("/api/runs/run/episodes/log/0/reward?{with}");
    let own = page.json(&path(""));
    let steps = page.json("/api/runs/run/episodes/log/0")["steps"].as_u64().unwrap() as usize;
    assert_eq!(own["rewards"].as_array().unwrap().len(), steps);
    // Without the uncertainty penalty, the rewards of Eq. 5 are larger.
    let free = page.json(&path("with=reward.uncertainty=0.0"));
    assert_eq!(own["proximity"], free["proximity"]);
    assert!(sum(&free["rewards"]) > sum(&own["rewards"]));
    let of_itself = page.json(&path("model=run"));
    assert_eq!(own, of_itself);
    for (with, status, line) in [
        ("with=ppo.clip=0.1", 400, "expected a key such as reward.uncertainty"),
        ("with=reward.nothing=1", 400, "unknown field `nothing`"),
        ("with=model=/etc", 400, "with: expected keys of the reward, found model=/etc"),
        ("model=nobody", 404, "no run is called nobody"),
    ] {
        let found = page.refusal(status, &page.question("GET", &path(with), page.address()));
        assert!(found.contains(line), "{found}");
    }
}

#[test]
fn solids_are_made_again_from_actions_alone() {
    let run = TestRun::new(programs!());
    run.train_task("fetch-push", &["log.observations=false"]).finish();
    let page = Page::over(&run, &["."]);
    let shown = page.json("/api/runs/run/episodes/log/3");
    let steps = shown["steps"].as_u64().unwrap() as usize;
    let length = shown["task"]["observation"]["vector"]["len"].as_u64().unwrap() as usize;
    assert_eq!(shown["values"].as_array().unwrap().len(), (steps + 1) * length);
    for collection in ["log/3", "demonstrations/0"] {
        let scenes = page.json(&format!("/api/runs/run/episodes/{collection}/scenes"));
        let parts = scenes["parts"].as_array().unwrap();
        let frames = scenes["frames"].as_array().unwrap();
        assert!(parts.len() > 4 && frames.len() > 1);
        assert!(frames.iter().all(|frame| frame.as_array().unwrap().len() == 7 * parts.len()));
    }
    let frames =
        page.json("/api/runs/run/episodes/log/3/scenes")["frames"].as_array().unwrap().len();
    assert_eq!(frames, steps + 1);

    // `goalward log scene` writes the same frames.
    let name = format!("{}:{}", shown["lane"], shown["episode"]);
    let (well, said) = run.goalward(&["log", "scene", "run", &name, "--out", "scene.mcap"]);
    assert!(well && said.contains(&format!("1 episodes, {frames} frames")), "{said}");
    let records =
        FileReader::open(&run.path("scene.mcap")).unwrap().map(|entry| entry.unwrap().record);
    let drawn = records.filter(|record| matches!(record, Record::Scene(_))).count();
    assert_eq!(drawn, frames);
    for (arguments, line) in [
        (["log", "scene", "run", "0:99999", "--out", "x.mcap"], "expected an episode 0:99999"),
        (["log", "scene", "run", "seven", "--out", "x.mcap"], "such as 3:17"),
        (["log", "scene", "run", &name, "--out", "scene.mcap"], "--force"),
    ] {
        let (well, said) = run.goalward(&arguments);
        assert!(!well && said.contains(line), "{said}");
    }
    let (well, said) =
        run.goalward(&["log", "scene", "run", &name, "--out", "scene.mcap", "--force"]);
    assert!(well, "{said}");
}

#[test]
fn rows_grow_while_a_run_trains_and_are_whole_after_a_death() {
    let run = TestRun::new(programs!());
    let mut training = run.train(&["steps=40000"]);
    training.await_checkpoint(4);
    let page = Page::over(&run, &["."]);
    let count = || rows(&page, "/api/runs/run/episodes/log").len();
    let first = count();
    let begun = Instant::now();
    while count() == first {
        assert!(begun.elapsed() < system_tests::PATIENCE, "expected more than {first} rows");
    }
    run.process("learner").signal(Signal::Kill);
    assert_eq!(training.end(), Some(0));
    let all = rows(&page, "/api/runs/run/episodes/log");
    // The file that the learner was writing has been sealed again, so its records are elsewhere in it.
    assert_eq!(page.json("/api/runs/run/episodes/log")["trouble"], Value::Array(Vec::new()));
    for place in [0, all.len() / 2] {
        let shown = page.json(&format!("/api/runs/run/episodes/log/{place}"));
        assert_eq!(shown["episode"], all[place]["episode"], "row {place}");
    }
    let mut recorded = BTreeMap::new();
    for entry in read_contents(&run.path("run/log"), Contents::Trajectories).unwrap() {
        if let Record::Score(score) = entry.unwrap().record {
            recorded
                .insert((score.lane, score.episode), f64::from(score.rewards.iter().sum::<f32>()));
        }
    }
    let trained: Vec<_> = all.iter().filter(|row| row["source"] == 0).collect();
    assert_eq!(trained.len(), recorded.len());
    for row in trained {
        let name = (row["lane"].as_u64().unwrap(), row["episode"].as_u64().unwrap());
        assert!(is_close(row["return"].as_f64().unwrap(), recorded[&name]), "{name:?}");
    }
}

#[test]
fn a_damaged_log_shows_what_can_be_read_and_says_so() {
    let run = TestRun::new(programs!());
    run.train(&[]).finish();
    let file = run.path("run/log/trajectories-00000.mcap");
    let bytes = std::fs::read(&file).unwrap();
    std::fs::write(&file, &bytes[..bytes.len() * 2 / 3]).unwrap();
    let page = Page::over(&run, &["."]);
    let found = page.json("/api/runs/run/episodes/log");
    assert!(found["trouble"].to_string().contains("cut off"), "{}", found["trouble"]);
    assert!(!found["rows"].as_array().unwrap().is_empty());
    std::fs::write(&file, [0; 100]).unwrap();
    let page = Page::over(&run, &["."]);
    let found = page.json("/api/runs/run/episodes/log");
    assert!(found["trouble"].to_string().contains("expected an MCAP file"), "{}", found["trouble"]);
}
