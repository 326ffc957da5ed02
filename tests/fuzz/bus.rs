//! Input from the bus: trajectories and other messages.

use std::time::Instant;

use learner::batch::RolloutBatch;
use learner::ledger::{LanePlan, LeaseLedger};
use prost::Message;
use protocol::messages::{
    Checkpoint, LeaseReply, LeaseRequest, PolicyUpdate, Progress, RewardUpdate, Score,
    ServiceReply, ServiceRequest,
};
use protocol::trajectory::{Encoded, Source, Trajectory};
use protocol::weights::Weights;

use crate::{Memory, Reader, fuzz, whole};
use protocol::task::Spec;
use system_tests::{TASKS, spec};

/// A repeated message of two bytes takes a hundred bytes in memory, and its vector grows by doubling.
const OF_MESSAGES: Memory = Memory { bytes: 16 << 10, per_byte: 400 };

fn rollout() -> LeaseLedger {
    let plan = LanePlan { first_episode: 5, steps_owed: 30, episodes_owed: 0 };
    LeaseLedger::open(Source::Training, 3, 3, vec![plan; 4])
}

/// Uses a trajectory as learner and service do.
fn learn_from(encoded: Encoded, spec: &Spec) {
    let trajectory = &encoded.trajectory;
    let steps = trajectory.steps as usize;
    let one = spec.observation.bytes();
    assert_eq!(trajectory.observations().len(), (steps + 1) * one);
    assert!(trajectory.observations_to_goal().len().is_multiple_of(one));
    if trajectory.source() != Source::Demonstration {
        assert_eq!(trajectory.actions().len(), steps * spec.action.bytes());
        let &Trajectory { iteration, lane, episode, .. } = trajectory;
        let rewards = vec![0.5; steps];
        let score = Score { iteration, lane, episode, rewards, ..Score::default() };
        let another = Score { lane: lane.wrapping_add(1), ..score.clone() };
        let episodes = std::slice::from_ref(&encoded);
        RolloutBatch::new(episodes, &[score], spec).unwrap();
        assert!(
            RolloutBatch::new(episodes, &[another], spec).is_err(),
            "the score of another episode"
        );
    }
    let mut rollout = rollout();
    rollout.receive(encoded.clone()).ok();
    rollout.receive(encoded).ok();
    rollout.into_batch();
}

#[test]
fn trajectories() {
    let specs = TASKS.map(spec);
    let read = |bytes: &[u8]| {
        let refusals = specs.map(|spec| {
            let encoded = Encoded::decode(bytes.to_vec().into(), &spec);
            encoded.map(|encoded| learn_from(encoded, &spec)).map_err(|error| error.to_string())
        });
        let mut lines = refusals.into_iter().filter_map(Result::err);
        let count = lines.by_ref().count();
        if count < TASKS.len() {
            return Ok(());
        }
        let error = Encoded::decode(bytes.to_vec().into(), &specs[0]);
        Err(error.unwrap_err().to_string())
    };
    fuzz(whole::trajectories(), &Reader { memory: OF_MESSAGES, read: &read });
}

/// Answers a lease request as the learner does.
fn answer(request: &LeaseRequest) {
    let mut rollout = rollout();
    for lease in &request.finished {
        rollout.hand_back(&request.actor, lease);
    }
    let leases = rollout.grant(&request.actor, request.capacity as usize, 2, Instant::now());
    assert!(leases.len() <= request.capacity as usize);
    let possible = request.seconds.filter(|seconds| seconds.is_possible());
    assert!(possible.is_none_or(|seconds| seconds.environment.is_finite()));
}

/// Decodes bytes as a message. They may be valid for several kinds, because encoded fields have no names.
fn is<M: Message + Default>(bytes: &[u8]) -> Result<M, String> {
    M::decode(bytes).map_err(|error| error.to_string())
}

#[test]
fn messages() {
    let read = |bytes: &[u8]| {
        let kinds = [
            is::<LeaseRequest>(bytes).map(|request| answer(&request)),
            is::<LeaseReply>(bytes).map(drop),
            is::<Progress>(bytes).map(drop),
            is::<Weights>(bytes).map(|weights| drop((weights.sha256(), weights.moment_numbers()))),
            is::<PolicyUpdate>(bytes).map(drop),
            is::<RewardUpdate>(bytes).map(drop),
            is::<Score>(bytes).map(drop),
            is::<Checkpoint>(bytes).map(drop),
            is::<ServiceRequest>(bytes).map(drop),
            is::<ServiceReply>(bytes).map(drop),
            is::<Trajectory>(bytes).map(drop),
        ];
        if kinds.iter().any(Result::is_ok) { Ok(()) } else { kinds.into_iter().next().unwrap() }
    };
    fuzz(whole::messages(), &Reader { memory: OF_MESSAGES, read: &read });
}
