//! Texts: configurations, settings, summaries, and the file that says where a bus is.

use std::cell::Cell;
use std::fs;
use std::path::Path;

use bus::BusAddress;
use protocol::build::Build;
use run::config::RunConfig;
use run::folder::RunFolder;
use run::origin::Demonstrations;
use run::summary::{EvaluationFigures, LogFigures, Seconds, Summary};
use run::time_to_success::TimeToSuccess;

use crate::{Memory, Reader, fuzz, whole};
use system_tests::TASKS;

/// A configuration is first parsed into a tree, and a tree of nested tables is large.
const OF_TEXTS: Memory = Memory { bytes: 512 << 10, per_byte: 2_000 };

/// Uses a configuration as `goalward` does before a run starts.
fn use_configuration(config: &RunConfig) {
    let again = RunConfig::from_text(&config.to_text(), "itself").unwrap();
    assert!(again.same_result_as(config));
    let counts = (config.iterations(), config.iteration_steps(), config.steps_wanted());
    assert!(counts.0 > 0, "{counts:?}");
    config.demonstration_setting();
}

#[test]
fn configurations() {
    let whole = TASKS.map(|task| whole::config(task).to_text().into_bytes());
    let read = |bytes: &[u8]| {
        let text = String::from_utf8_lossy(bytes);
        let config = RunConfig::from_text(&text, "config.toml").map_err(|why| why.to_string())?;
        use_configuration(&config);
        Ok(())
    };
    fuzz(whole.to_vec(), &Reader { memory: OF_TEXTS, read: &read });
}

#[test]
fn settings() {
    let config = whole::config("fetch-push");
    let whole = [
        "ppo.clip=0.3",
        "rollout.lanes=4",
        "rollout.lane_steps=100",
        "policy.hidden=[16, 16]",
        "method=gaifo-s",
        "demonstrations.file=\"some.mcap\"",
        "environment.action_scale=[0.1, 0.2, 0.3]",
        "steps=1000",
        "resources={actors=1}",
    ];
    let read = |bytes: &[u8]| {
        let setting = String::from_utf8_lossy(bytes).into_owned();
        let changed = config.with_settings(&[setting]).map_err(|why| why.to_string())?;
        use_configuration(&changed);
        Ok(())
    };
    let whole = whole.map(|setting| setting.as_bytes().to_vec());
    fuzz(whole.to_vec(), &Reader { memory: OF_TEXTS, read: &read });
}

fn summary() -> Summary {
    Summary {
        task: "navigation".to_owned(),
        method: "goal-proximity".to_owned(),
        preset: "goalward".to_owned(),
        seed: 1,
        actors: 2,
        environment_steps: 8_000,
        episodes: 100,
        iterations: 20,
        success_rate: Some(0.5),
        evaluation: EvaluationFigures { episodes: 8, success_rate: None, mean_return: Some(0.25) },
        wall_s: 3.5,
        processor_s: 5.5,
        time_to_success: vec![TimeToSuccess {
            success_rate: 0.5,
            environment_steps: 7_600,
            wall_s: 3.0,
            processor_s: 5.0,
        }],
        steps_per_s: 2_000.0,
        policy_sha256: "ab".repeat(32),
        reward_model_sha256: "cd".repeat(32),
        builds: vec![Build::own().clone()],
        demonstrations: Some(Demonstrations {
            sha256: "ef".repeat(32),
            of_own_seed: true,
            build: Build::own().clone(),
        }),
        log: LogFigures { files: 2, trajectories: 108, bytes: 1 << 20 },
        seconds: Seconds::default(),
    }
}

/// Makes a reader that writes its input to a file of a run folder and then reads it.
fn of_run<T>(
    name: &'static str,
    read: impl Fn(&RunFolder) -> Result<T, String>,
) -> impl Fn(&[u8]) -> Result<(), String> {
    let run = tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).unwrap();
    let folder = RunFolder::new(run.path());
    let kept = Cell::new(Some(run));
    move |bytes| {
        fs::write(folder.path().join(name), bytes).unwrap();
        let outcome = read(&folder).map(drop);
        kept.set(kept.take());
        outcome
    }
}

#[test]
fn summaries() {
    let run = tempfile::tempdir().unwrap();
    let folder = RunFolder::new(run.path());
    summary().save(&folder).unwrap();
    let whole = fs::read(folder.summary_file()).unwrap();
    let read =
        of_run("summary.json", |folder| Summary::of_run(folder).map_err(|error| error.to_string()));
    fuzz(vec![whole], &Reader { memory: OF_TEXTS, read: &read });
}

#[test]
fn places_of_a_bus() {
    let run = tempfile::tempdir().unwrap();
    BusAddress::for_start(run.path()).unwrap();
    let whole = fs::read(run.path().join("bus")).unwrap();
    let read = of_run("bus", |folder| {
        let address = BusAddress::of_run(folder.path()).map_err(|error| error.to_string())?;
        assert!(address.root().is_absolute() && Path::new(address.prefix()).is_relative());
        Ok(())
    });
    fuzz(vec![whole], &Reader { memory: OF_TEXTS, read: &read });
}
