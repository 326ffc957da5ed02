//! Small valid inputs, as our own processes make them.

use bytes::Bytes;
use prost::Message;
use protocol::ending::Ending;
use protocol::messages::{
    ActorSeconds, Answer, Ask, BatchRequest, Begin, Checkpoint, Estimates, IterationRequest, Lease,
    LeaseReply, LeaseRequest, Missing, PolicyUpdate, Pretraining, Progress, Query, RewardUpdate,
    Save, Saved, Score, Scores, ServiceReply, ServiceRequest,
};
use protocol::task::{ActionSpec, ObservationSpec};
use protocol::trajectory::{Source, Trajectory, TrajectoryKey};
use protocol::weights::Weights;
use run::config::RunConfig;
use system_tests::{TASKS, small, spec};

/// Steps of each trajectory.
const STEPS: usize = 3;

/// Returns the configuration of a small run.
pub(crate) fn config(task: &str) -> RunConfig {
    let settings: Vec<String> = small(task).iter().map(|&setting| setting.to_owned()).collect();
    run::tasks::configuration(task, None, &settings).unwrap()
}

/// Returns a valid trajectory of a task.
pub(crate) fn trajectory(task: &str, source: Source) -> Trajectory {
    let spec = spec(task);
    let zeros = |count: usize| Bytes::from(vec![0; count]);
    let observed = zeros((STEPS + 1) * spec.observation.bytes());
    let (cells, values) = match spec.observation {
        ObservationSpec::Cells { .. } => (observed, Bytes::new()),
        ObservationSpec::Vector { .. } => (Bytes::new(), observed),
    };
    let acted = zeros(STEPS * spec.action.bytes());
    let (discrete_actions, continuous_actions) = match spec.action {
        ActionSpec::Discrete { .. } => (acted, Bytes::new()),
        ActionSpec::Continuous { .. } => (Bytes::new(), acted),
    };
    let is_demonstration = source == Source::Demonstration;
    Trajectory {
        task: task.to_owned(),
        source: source as i32,
        iteration: 3,
        lane: 1,
        episode: 6,
        policy_version: 3,
        run_seed: 1,
        steps: STEPS as u32,
        observation_shape: spec.observation.shape(),
        cells,
        values,
        discrete_actions,
        continuous_actions,
        log_probs: if is_demonstration { Bytes::new() } else { zeros(4 * STEPS) },
        environment_rewards: zeros(4 * STEPS),
        ending: Ending::GoalReached as i32,
        success: true,
        state_hash: 7,
        steps_to_goal: STEPS as u32,
        full_hash: 0,
    }
}

/// Returns encoded trajectories of every task and source.
pub(crate) fn trajectories() -> Vec<Vec<u8>> {
    let sources = [Source::Training, Source::Evaluation, Source::Demonstration];
    let of_task = |task| sources.map(|source| trajectory(task, source).encode_to_vec());
    TASKS.into_iter().flat_map(of_task).collect()
}

/// Returns a lease of the rollout that the trajectories belong to.
pub(crate) fn lease() -> Lease {
    Lease {
        source: Source::Training as i32,
        iteration: 3,
        lane: 1,
        policy_version: 3,
        first_episode: 5,
        steps_owed: 30,
        episodes_owed: 0,
    }
}

/// Returns encoded messages of the bus and of the log, other than trajectories.
pub(crate) fn messages() -> Vec<Vec<u8>> {
    let key = TrajectoryKey { lane: 1, episode: 2, hash: 3 };
    let update = PolicyUpdate { consumed: vec![key; 3], ..PolicyUpdate::default() };
    let reward_update = RewardUpdate { weights_sha256: "ab".repeat(32), ..RewardUpdate::default() };
    let score = Score { rewards: vec![0.5; 3], proximity: vec![0.5; 4], ..Score::default() };
    let request = LeaseRequest {
        actor: "actor-0-17".to_owned(),
        capacity: 16,
        finished: vec![lease(); 2],
        seconds: Some(ActorSeconds {
            environment: 0.5,
            inference: 0.25,
            transport: 0.125,
            processor: 1.5,
        }),
    };
    let progress = Progress {
        update: Some(update.clone()),
        reward_update: Some(reward_update.clone()),
        steps_wanted: 8_000,
        ..Progress::default()
    };
    let mut messages = vec![
        request.encode_to_vec(),
        LeaseReply { leases: vec![lease(); 2], finished: false }.encode_to_vec(),
        progress.encode_to_vec(),
        Weights::new(3, &[0.5; 9], &[0.25; 6]).encode_to_vec(),
        update.encode_to_vec(),
        reward_update.encode_to_vec(),
        score.encode_to_vec(),
        Checkpoint { path: "checkpoints/000004".to_owned(), ..Checkpoint::default() }
            .encode_to_vec(),
    ];
    messages.extend(asks(key).map(|ask| ServiceRequest { ask: Some(ask) }.encode_to_vec()));
    let answers = [
        Answer::Updated(reward_update),
        Answer::Missing(Missing { positions: vec![0, 300] }),
        Answer::Scores(Scores { scores: vec![score] }),
        Answer::Saved(Saved { weights_sha256: "ab".repeat(32), ..Saved::default() }),
        Answer::Estimates(Estimates { proximity: vec![0.5], ..Estimates::default() }),
        Answer::Refused("no".to_owned()),
        Answer::Final("never".to_owned()),
        Answer::Pretraining(Pretraining { done: 3, total: 300 }),
    ];
    messages.extend(answers.map(|answer| ServiceReply { answer: Some(answer) }.encode_to_vec()));
    messages
}

fn asks(key: TrajectoryKey) -> [Ask; 6] {
    let supplied = vec![trajectory("fetch-push", Source::Training).encode_to_vec().into()];
    [
        Ask::Begin(Begin { iteration: 4, checkpoint: "checkpoints/000004/proximity".to_owned() }),
        Ask::Batch(BatchRequest { iteration: 3, keys: vec![key; 2], supplied }),
        Ask::Score(IterationRequest { iteration: 3 }),
        Ask::Improve(IterationRequest { iteration: 3 }),
        Ask::Save(Save { path: "file".to_owned() }),
        Ask::Query(Query { observations: Bytes::from(vec![0; 64]) }),
    ]
}
