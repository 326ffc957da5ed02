//! A run's log is complete: it has every trajectory exactly once, every score and every update.
//!
//! Method: a run is trained and its log is read as a tool would read it, with `mcap_log` alone. The log is then
//! checked against itself (the trajectories that an update consumed are recorded, with the same hashes) and against
//! `config.toml` and `summary.json`. A run whose learner is killed in the middle records some iterations twice; its
//! log must read exactly like that of the undisturbed run.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::time::Duration;

use mcap_log::{Ending, FileReader, Kind, Record, log_files, read_run};
use protocol::messages::{Checkpoint, PolicyUpdate, RewardUpdate, Score};
use protocol::trajectory::{Encoded, Source, TrajectoryKey};
use system_tests::{
    CHECKPOINT_ITERATIONS, ITERATIONS, LANES, Signal, Summary, TestRun, programs, spec,
};

/// Everything that a run recorded, in order.
#[derive(Default)]
struct Recorded {
    trajectories: Vec<Encoded>,
    evaluations: Vec<Encoded>,
    scores: Vec<Score>,
    policy_updates: Vec<PolicyUpdate>,
    reward_updates: Vec<RewardUpdate>,
    checkpoints: Vec<Checkpoint>,
    left_out: u64,
}

impl Recorded {
    fn of(run: &TestRun) -> Recorded {
        let mut reader = read_run(&run.folder().log()).unwrap();
        let mut recorded = Recorded { left_out: reader.left_out(), ..Recorded::default() };
        let decode = |bytes| Encoded::decode(bytes, &spec("navigation")).unwrap();
        let mut seen = BTreeSet::new();
        for entry in &mut reader {
            match entry.unwrap().record {
                Record::Trajectory(bytes) => {
                    let encoded = decode(bytes);
                    seen.insert(encoded.key);
                    recorded.trajectories.push(encoded);
                }
                Record::EvaluationTrajectory(bytes) => recorded.evaluations.push(decode(bytes)),
                Record::Score(score) => recorded.scores.push(score),
                Record::PolicyUpdate(update) => {
                    let is_recorded = |key: &TrajectoryKey| seen.contains(key);
                    assert!(update.consumed.iter().all(is_recorded), "learned from, then recorded");
                    recorded.policy_updates.push(*update);
                }
                Record::RewardUpdate(update) => recorded.reward_updates.push(update),
                Record::Checkpoint(checkpoint) => recorded.checkpoints.push(checkpoint),
                Record::Scene(_) | Record::Picture(_) => {
                    panic!("expected nothing drawn in the log of a run")
                }
            }
        }
        recorded
    }

    /// Keys of the training trajectories, by iteration; fails if one is recorded twice.
    fn keys(&self) -> BTreeMap<u64, BTreeSet<TrajectoryKey>> {
        let mut keys: BTreeMap<u64, BTreeSet<TrajectoryKey>> = BTreeMap::new();
        for encoded in &self.trajectories {
            let is_new = keys.entry(encoded.trajectory.iteration).or_default().insert(encoded.key);
            assert!(is_new, "recorded twice: {:?}", encoded.key);
        }
        keys
    }
}

/// Makes all checks that must hold for a finished run, however often it was disturbed.
fn check(run: &TestRun, recorded: &Recorded, summary: &Summary) {
    check_configuration(run);
    check_trajectories(recorded, summary);
    check_scores(recorded);
    check_policy_updates(recorded, summary);
    check_reward_updates(recorded, summary);
    check_checkpoints(run, recorded, summary);
}

/// Every file begins with metadata of the run. The reader refuses files whose first record is not metadata.
fn check_configuration(run: &TestRun) {
    let text = fs::read_to_string(run.folder().config_file()).unwrap();
    for file in log_files(&run.folder().log()).unwrap() {
        let reader = FileReader::open(&file.path).unwrap();
        let metadata = reader.metadata();
        assert_eq!(metadata.kind, Kind::Run);
        assert_eq!(metadata.get("config"), Some(text.as_str()), "{}", file.path.display());
        assert_eq!((metadata.get("task"), metadata.get("seed")), (Some("navigation"), Some("1")));
    }
}

/// Every lane has all episodes from the first to the last, each once, from the policy of its iteration.
fn check_trajectories(recorded: &Recorded, summary: &Summary) {
    let mut lanes: BTreeMap<u64, Vec<u64>> = BTreeMap::new();
    for encoded in &recorded.trajectories {
        let trajectory = &encoded.trajectory;
        assert_eq!(trajectory.source, Source::Training as i32);
        assert_eq!(trajectory.policy_version, trajectory.iteration);
        lanes.entry(trajectory.lane).or_default().push(trajectory.episode);
    }
    assert_eq!(lanes.len() as u64, LANES);
    for (lane, mut episodes) in lanes {
        episodes.sort_unstable();
        let expected: Vec<u64> = (0..episodes.len() as u64).collect();
        assert_eq!(episodes, expected, "lane {lane}");
    }
    let steps = |encoded: &Encoded| u64::from(encoded.trajectory.steps);
    assert_eq!(recorded.trajectories.iter().map(steps).sum::<u64>(), summary.environment_steps);
    assert_eq!(recorded.trajectories.len() as u64, summary.episodes);
    assert_eq!(recorded.evaluations.len() as u64, summary.evaluation.episodes);
    assert_eq!(recorded.keys().len() as u64, ITERATIONS);
}

/// Every training trajectory has exactly one score, of matching length.
fn check_scores(recorded: &Recorded) {
    type Name = (u64, u64, u64);
    let steps: BTreeMap<Name, usize> = recorded
        .trajectories
        .iter()
        .map(|Encoded { trajectory, .. }| {
            let name = (trajectory.iteration, trajectory.lane, trajectory.episode);
            (name, trajectory.steps as usize)
        })
        .collect();
    let mut scored = BTreeSet::new();
    for score in &recorded.scores {
        let name = (score.iteration, score.lane, score.episode);
        assert!(scored.insert(name), "two scores of {name:?}");
        let steps = steps[&name];
        let found = (score.rewards.len(), score.proximity.len(), score.uncertainty.len());
        assert_eq!(found, (steps, steps + 1, steps + 1), "{name:?}");
        // Algorithm 1: after offline training, each iteration is scored before the model learns from it.
        assert_eq!(score.model_version, score.iteration + 1, "{name:?}");
        assert!(score.rewards.iter().all(|reward| reward.is_finite()));
        assert!(score.proximity.iter().all(|proximity| (0.0..=1.0).contains(proximity)));
        assert!(score.uncertainty.iter().all(|&uncertainty| uncertainty >= 0.0));
    }
    assert_eq!(scored.len(), steps.len());
}

/// Each iteration has one policy update, which consumed exactly the trajectories that the iteration recorded.
fn check_policy_updates(recorded: &Recorded, summary: &Summary) {
    let iterations: Vec<u64> = recorded.policy_updates.iter().map(|one| one.iteration).collect();
    assert_eq!(iterations, (0..ITERATIONS).collect::<Vec<_>>());
    let mut keys = recorded.keys();
    for update in &recorded.policy_updates {
        assert_eq!(update.policy_version, update.iteration + 1);
        let consumed: BTreeSet<_> = update.consumed.iter().copied().collect();
        assert_eq!(consumed.len(), update.consumed.len(), "a trajectory was consumed twice");
        assert_eq!(Some(consumed), keys.remove(&update.iteration), "{}", update.iteration);
    }
    let last = recorded.policy_updates.last().unwrap();
    assert_eq!(last.weights_sha256, summary.policy_sha256);
    assert_eq!(last.environment_steps, summary.environment_steps);
    assert_eq!(last.episodes, summary.episodes);
    assert_eq!(Some(last.success_rate), summary.success_rate);
}

/// The reward model has an update for offline training, then one for each iteration.
fn check_reward_updates(recorded: &Recorded, summary: &Summary) {
    let names: Vec<_> =
        recorded.reward_updates.iter().map(|one| (one.iteration, one.model_version)).collect();
    let online = (0..ITERATIONS).map(|iteration| (iteration, iteration + 2));
    let expected: Vec<_> = std::iter::once((0, 1)).chain(online).collect();
    assert_eq!(names, expected, "as (iteration, model version)");
    let last = recorded.reward_updates.last().unwrap();
    assert_eq!(last.weights_sha256, summary.reward_model_sha256);
}

/// Every checkpoint is recorded with the policy hash of its iteration and is where the record says; the last one has
/// the final hash of the reward model.
fn check_checkpoints(run: &TestRun, recorded: &Recorded, summary: &Summary) {
    let found: Vec<u64> = recorded.checkpoints.iter().map(|one| one.iteration).collect();
    let step = CHECKPOINT_ITERATIONS as usize;
    assert_eq!(found, (step as u64..=ITERATIONS).step_by(step).collect::<Vec<_>>());
    for checkpoint in &recorded.checkpoints {
        assert!(run.folder().path().join(&checkpoint.path).is_dir(), "{}", checkpoint.path);
        let update = &recorded.policy_updates[checkpoint.iteration as usize - 1];
        assert_eq!(checkpoint.policy_sha256, update.weights_sha256);
    }
    let last = recorded.checkpoints.last().unwrap();
    assert_eq!(last.proximity_sha256, summary.reward_model_sha256);
}

#[test]
fn the_log_holds_the_whole_run() {
    let run = TestRun::new(programs!());
    let summary = run.finish(&[]);
    let recorded = Recorded::of(&run);
    check(&run, &recorded, &summary);
    assert_eq!(recorded.left_out, 0);

    let mut reader = read_run(&run.folder().log()).unwrap();
    assert!(reader.by_ref().all(|entry| entry.is_ok()));
    for (path, ending) in reader.endings() {
        assert_eq!(*ending, Ending::Complete, "{}", path.display());
    }
    let files = log_files(&run.folder().log()).unwrap();
    let bytes = files.iter().map(|file| fs::metadata(&file.path).unwrap().len()).sum();
    assert_eq!((files.len() as u64, bytes), (summary.log.files, summary.log.bytes));
    let trajectories = recorded.trajectories.len() + recorded.evaluations.len();
    assert_eq!(trajectories as u64, summary.log.trajectories);
    check_again_after_a_killed_learner(&recorded);
}

/// Repeats the checks with a killed learner. Part of the test above, whose undisturbed record it compares with.
fn check_again_after_a_killed_learner(undisturbed: &Recorded) {
    let run = TestRun::new(programs!());
    let mut training = run.train(&["checkpoint.iterations=4"]);
    training.await_checkpoint(8);
    // While the learner waits for the service, what it has recorded since the checkpoint gets to the disk.
    let service = run.process("proximity-service");
    service.signal(Signal::Stop);
    std::thread::sleep(Duration::from_secs(3));
    run.process("learner").signal(Signal::Kill);
    service.signal(Signal::Continue);
    let summary = training.finish();
    let recorded = Recorded::of(&run);
    check(&run, &recorded, &summary);
    assert!(recorded.left_out > 0, "nothing was recorded twice, so nothing was shown");
    assert_eq!(recorded.keys(), undisturbed.keys());
    assert_eq!(recorded.scores, undisturbed.scores);
    let weights = |recorded: &Recorded| {
        let updates = recorded.policy_updates.iter();
        updates.map(|update| update.weights_sha256.clone()).collect::<Vec<_>>()
    };
    assert_eq!(weights(&recorded), weights(undisturbed));
}
