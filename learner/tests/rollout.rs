//! Leases: whatever actors do, a rollout ends with the same batch.

use std::time::{Duration, Instant};

use learner::rollout::{LanePlan, Rollout};
use proptest::prelude::*;
use protocol::messages::Lease;
use protocol::trajectory::{Encoded, Source, Trajectory};

const TIMEOUT: Duration = Duration::from_secs(10);

fn rollout(lanes: usize) -> Rollout {
    let plan = LanePlan { first_episode: 5, steps_owed: 30, episodes_owed: 0 };
    Rollout::open(Source::Training, 3, 3, vec![plan; lanes])
}

/// The episodes of a lease, each of 10 + lane steps.
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

proptest! {
    /// Actors die after any number of episodes, lose some, publish some twice and late.
    #[test]
    fn deaths_and_losses_change_nothing(
        fates in prop::collection::vec((0usize..4, any::<bool>(), any::<bool>()), 0..40),
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
                let (published, dies, twice) = fates.next().unwrap_or((usize::MAX, false, true));
                for encoded in run(&lease).into_iter().take(published) {
                    if twice {
                        late.push(encoded.clone());
                    }
                    rollout.receive(encoded).unwrap();
                }
                if !dies {
                    rollout.hand_back(&actor, &lease);
                }
            }
            rollout.reopen(&[], TIMEOUT, Instant::now());
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
    let alive = ["actor-0".to_owned()];
    assert_eq!(rollout.reopen(&alive, TIMEOUT, start + TIMEOUT), 0);
    assert!(rollout.grant("actor-1", 1, 1, start).is_empty());
    assert_eq!(rollout.reopen(&alive, TIMEOUT, start + 2 * TIMEOUT), 1);
    let again = rollout.grant("actor-1", 1, 1, start)[0];
    assert_eq!((again.first_episode, again.steps_owed), (6, 20));
}

#[test]
fn an_actor_gets_a_share_and_leaves_some_for_the_others() {
    let mut rollout = rollout(32);
    assert_eq!(rollout.grant("actor-0", 100, 2, Instant::now()).len(), 8);
    assert_eq!(rollout.grant("actor-1", 4, 2, Instant::now()).len(), 4);
    assert_eq!(rollout.held(), 12);
}

#[test]
fn a_trajectory_of_another_policy_or_content_is_refused() {
    let mut rollout = rollout(1);
    let lease = rollout.grant("actor-0", 1, 1, Instant::now())[0];
    let good = run(&lease).remove(0);
    rollout.receive(good.clone()).unwrap();
    let other = Trajectory { success: true, ..good.trajectory.clone() };
    let message = rollout.receive(Encoded::encode(other)).unwrap_err().to_string();
    assert!(message.contains("came twice and differs"), "{message}");
    let stale = Trajectory { policy_version: 2, ..good.trajectory };
    let message = rollout.receive(Encoded::encode(stale)).unwrap_err().to_string();
    assert!(message.contains("expected policy version 3, found 2"), "{message}");
}
