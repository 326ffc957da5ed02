//! Leases: whatever actors do, a rollout ends with the same batch.

use std::time::{Duration, Instant};

use learner::ledger::{LanePlan, LeaseLedger};
use proptest::prelude::*;
use prost::Message;
use protocol::messages::{Lease, LeaseReply};
use protocol::trajectory::{Encoded, Source, Trajectory};

const TIMEOUT: Duration = Duration::from_secs(10);

fn rollout(lanes: usize) -> LeaseLedger {
    let plan = LanePlan { first_episode: 5, steps_owed: 30, episodes_owed: 0 };
    LeaseLedger::open(Source::Training, 3, 3, vec![plan; lanes])
}

/// Returns the episodes of a lease, each of 10 + lane steps.
fn run(lease: &Lease) -> Vec<Encoded> {
    let (mut owed, mut episode) = (lease.steps_owed, lease.first_episode);
    let mut trajectories = Vec::new();
    while owed > 0 {
        let steps = 10 + lease.lane;
        let trajectory = Trajectory {
            iteration: lease.iteration,
            lane: lease.lane,
            episode,
            policy_version: lease.policy_version,
            steps: steps as u32,
            ..Trajectory::default()
        };
        trajectories.push(Encoded::encode(trajectory));
        owed = owed.saturating_sub(steps);
        episode += 1;
    }
    trajectories
}

fn undisturbed(lanes: usize) -> Vec<Encoded> {
    let mut rollout = rollout(lanes);
    while !rollout.is_complete() {
        for lease in rollout.grant("actor-0", 100, 1, Instant::now()) {
            for encoded in run(&lease) {
                assert!(rollout.receive(encoded).expect("a good trajectory"));
            }
        }
    }
    rollout.into_batch()
}

#[test]
fn who_holds_what_is_known() {
    let mut rollout = rollout(4);
    let leases = rollout.grant("actor-0", 2, 1, Instant::now());
    let held = |rollout: &LeaseLedger| ["actor-0", "actor-1"].map(|actor| rollout.held_by(actor));
    assert_eq!(held(&rollout), [leases.len(), 0]);
    assert_eq!(rollout.holder(leases[0].lane), Some("actor-0"));
    assert_eq!(rollout.holder(99), None);
    for encoded in run(&leases[0]) {
        rollout.receive(encoded).expect("a good trajectory");
    }
    assert_eq!(held(&rollout), [leases.len() - 1, 0]);
}

proptest! {
    /// Actors die before they have run all episodes, any episodes are lost, and some are published twice and late.
    #[test]
    fn deaths_and_losses_change_nothing(
        fates in prop::collection::vec((any::<u8>(), any::<bool>(), any::<bool>()), 0..40),
    ) {
        let mut rollout = rollout(4);
        let mut fates = fates.into_iter();
        let mut late = Vec::new();
        for round in 0.. {
            if rollout.is_complete() {
                break;
            }
            let actor = format!("actor-{round}");
            for lease in rollout.grant(&actor, 2, 2, Instant::now()) {
                let (kept, dies, twice) = fates.next().unwrap_or((u8::MAX, false, true));
                let is_kept = |at: usize| kept >> (at % 8) & 1 == 1;
                let episodes = run(&lease).into_iter().enumerate();
                for (_, encoded) in episodes.filter(|&(at, _)| is_kept(at)) {
                    if twice {
                        late.push(encoded.clone());
                    }
                    rollout.receive(encoded).unwrap();
                }
                if !dies {
                    rollout.hand_back(&actor, &lease);
                }
            }
            rollout.reopen_lost(&[]);
            for encoded in late.drain(..) {
                prop_assert!(!rollout.receive(encoded).unwrap());
            }
        }
        prop_assert_eq!(rollout.into_batch(), undisturbed(4));
    }
}

#[test]
fn a_lease_held_too_long_is_handed_out_again_from_the_first_missing_episode() {
    let mut rollout = rollout(1);
    let start = Instant::now();
    let lease = rollout.grant("actor-0", 1, 1, start)[0];
    let mut episodes = run(&lease).into_iter();
    rollout.receive(episodes.next().unwrap()).unwrap();
    assert_eq!(rollout.reopen_lost(&["actor-0".to_owned()]), 0);
    assert_eq!(rollout.reopen_overdue(TIMEOUT, start + TIMEOUT), 0);
    assert!(rollout.grant("actor-1", 1, 1, start).is_empty());
    assert_eq!(rollout.reopen_overdue(TIMEOUT, start + 2 * TIMEOUT), 1);
    let again = rollout.grant("actor-1", 1, 1, start)[0];
    assert_eq!((again.first_episode, again.steps_owed), (6, 20));
}

#[test]
fn a_lease_of_an_actor_that_lives_is_its_own_while_others_are_open() {
    let mut rollout = rollout(2);
    let start = Instant::now();
    let late = start + 2 * TIMEOUT;
    assert_eq!(rollout.grant("actor-0", 1, 1, start)[0].lane, 0);
    assert_eq!(rollout.reopen_overdue(TIMEOUT, late), 0, "nobody needs it");
    assert_eq!(rollout.grant("actor-1", 1, 1, late)[0].lane, 1);
    assert_eq!(rollout.reopen_overdue(TIMEOUT, late), 1);
    assert_eq!(rollout.grant("actor-1", 1, 1, late)[0].lane, 0);
    assert_eq!(rollout.reopen_lost(&[]), 2, "a dead actor's are open at once");
}

#[test]
fn of_an_evaluated_episode_its_bytes_are_not_kept() {
    let plan = LanePlan { first_episode: 0, steps_owed: 0, episodes_owed: 1 };
    let mut rollout = LeaseLedger::open(Source::Evaluation, 3, 3, vec![plan]);
    let whole = Encoded::encode(Trajectory {
        source: Source::Evaluation as i32,
        iteration: 3,
        policy_version: 3,
        steps: 2,
        cells: vec![1; 27].into(),
        discrete_actions: vec![1, 2].into(),
        log_probs: vec![0; 8].into(),
        environment_rewards: [0.5_f32, 1.0].map(f32::to_le_bytes).concat().into(),
        success: true,
        steps_to_goal: 2,
        ..Trajectory::default()
    });
    assert!(rollout.receive(whole.clone()).unwrap());
    assert!(!rollout.receive(whole.clone()).unwrap(), "a copy has the same hash");
    assert!(rollout.is_complete());
    let batch = rollout.into_batch();
    assert_eq!(batch.len(), 1);
    let Encoded { trajectory, bytes, key } = &batch[0];
    assert_eq!((*key, trajectory.success), (whole.key, true));
    assert_eq!(trajectory.environment_return(), 1.5);
    assert!(bytes.is_empty() && trajectory.observations().is_empty());
    assert!(trajectory.actions().is_empty() && trajectory.log_probs.is_empty());
}

#[test]
fn an_actor_gets_a_share_and_leaves_some_for_the_others() {
    let mut rollout = rollout(32);
    assert_eq!(rollout.grant("actor-0", 100, 2, Instant::now()).len(), 8);
    assert_eq!(rollout.grant("actor-1", 4, 2, Instant::now()).len(), 4);
    assert_eq!(rollout.held(), 12);
}

/// A trajectory that is not part of a rollout is refused with a message and changes nothing; what came first is kept.
#[test]
fn what_is_no_part_of_the_rollout_is_refused_and_changes_nothing() {
    let mut rollout = rollout(1);
    let lease = rollout.grant("actor-0-17", 1, 1, Instant::now())[0];
    let episodes = run(&lease);
    let good = episodes[0].clone();
    rollout.receive(good.clone()).unwrap();
    let other = |change: fn(&mut Trajectory)| {
        let mut trajectory = good.trajectory.clone();
        change(&mut trajectory);
        Encoded::encode(trajectory)
    };
    for (encoded, words) in [
        (other(|one| one.policy_version = 2), "expected policy version 3, found 2"),
        (other(|one| one.lane = u64::MAX), "expected a lane below 1"),
        (other(|one| one.episode = u64::MAX), "expected an episode below 35"),
        (other(|one| one.success = true), "came twice and differs"),
    ] {
        let message = rollout.receive(encoded).unwrap_err().to_string();
        assert!(message.contains(words), "{message}");
    }
    let differing = rollout.receive(other(|one| one.success = true)).unwrap_err().to_string();
    let hash = format!("{:016x} is kept", good.key.hash);
    assert!(differing.contains(&hash) && differing.contains("actor-0-17"), "{differing}");
    for encoded in episodes.iter().cloned() {
        rollout.receive(encoded).unwrap();
    }
    assert!(rollout.is_complete());
    assert_eq!(rollout.into_batch(), episodes);
}

#[test]
fn an_episode_that_nobody_owes_is_not_learned_from() {
    let mut rollout = rollout(1);
    let lease = rollout.grant("actor-0", 1, 1, Instant::now())[0];
    let episodes = run(&lease);
    let beyond = Trajectory { episode: 20, ..episodes[0].trajectory.clone() };
    rollout.receive(Encoded::encode(beyond)).unwrap();
    for encoded in episodes.iter().cloned() {
        rollout.receive(encoded).unwrap();
    }
    assert_eq!(rollout.into_batch(), episodes);
}

#[test]
fn an_answer_has_a_place_whatever_is_asked_for() {
    let leases = rollout(4096).grant("actor-0", u32::MAX as usize, 0, Instant::now());
    let reply = LeaseReply { leases, finished: false };
    assert!(!reply.leases.is_empty() && reply.encoded_len() < 32 << 10, "{}", reply.encoded_len());
}
