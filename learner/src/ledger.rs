//! The ledger of leases of one iteration's rollout: what each lane owes, who holds which lease, and what has arrived.
//!
//! Pure bookkeeping between the desk, which talks to actors, and the trainer, which needs batches. What a lease
//! produces depends on its fields alone, so granting one twice is always safe: the copy of a trajectory that
//! arrives first counts, and the other has the same bytes.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use bytes::Bytes;
use protocol::messages::Lease;
use protocol::trajectory::{Encoded, Source, Trajectory};

/// What a lane has to run, and from which episode.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LanePlan {
    /// First episode.
    pub first_episode: u64,
    /// Minimum number of steps.
    pub steps_owed: u64,
    /// Minimum number of episodes.
    pub episodes_owed: u64,
}

/// Maximum number of leases per reply, so that it fits its slot on the bus whatever the actor asks for.
const LEASES_AT_ONCE: usize = 128;

/// Why a trajectory is not part of the rollout that it names.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Unusable {
    /// Another policy acted.
    #[error("lane {lane} episode {episode}: expected policy version {expected}, found {found}")]
    PolicyVersion {
        /// Its lane.
        lane: u64,
        /// Its episode.
        episode: u64,
        /// The version that acts in this rollout.
        expected: u64,
        /// The version that the trajectory names.
        found: u64,
    },
    /// There is no such lane.
    #[error("expected a lane below {lanes}, found {found}")]
    Lane {
        /// Lanes of the rollout.
        lanes: usize,
        /// The lane that the trajectory names.
        found: u64,
    },
    /// No lease can contain this episode.
    #[error("lane {lane}: expected an episode below {end}, found {found}")]
    Episode {
        /// Its lane.
        lane: u64,
        /// The first episode that the lane cannot owe.
        end: u64,
        /// The episode that the trajectory names.
        found: u64,
    },
    /// A lease gives the same bytes whoever runs it, so one of the two copies is wrong. The first is kept.
    #[error(
        "lane {lane} episode {episode} came twice and differs: {kept:016x} is kept, \
         {found:016x} is not; held by {holder}"
    )]
    Differs {
        /// Its lane.
        lane: u64,
        /// Its episode.
        episode: u64,
        /// Hash of the one that came first.
        kept: u64,
        /// Hash of this one.
        found: u64,
        /// The actor that holds the lane's lease, or "nobody".
        holder: String,
    },
}

/// The leases of one iteration's rollout.
#[derive(Debug)]
pub struct LeaseLedger {
    source: Source,
    iteration: u64,
    policy_version: u64,
    lanes: Vec<LaneLedger>,
}

/// What a lane owes and has delivered.
#[derive(Debug)]
struct LaneLedger {
    plan: LanePlan,
    /// What is still owed after the episodes received without a gap.
    rest: LanePlan,
    received: BTreeMap<u64, Encoded>,
    holder: Option<Holder>,
}

#[derive(Debug)]
struct Holder {
    actor: String,
    since: Instant,
}

impl LeaseLedger {
    /// Opens a rollout with one plan per lane.
    pub fn open(
        source: Source,
        iteration: u64,
        policy_version: u64,
        plans: Vec<LanePlan>,
    ) -> LeaseLedger {
        let lane = |plan| LaneLedger { plan, rest: plan, received: BTreeMap::new(), holder: None };
        let lanes = plans.into_iter().map(lane).collect();
        LeaseLedger { source, iteration, policy_version, lanes }
    }

    /// Grants up to `capacity` of the leases that nobody holds, but leaves some for the other actors.
    pub fn grant(
        &mut self,
        actor: &str,
        capacity: usize,
        actors: usize,
        now: Instant,
    ) -> Vec<Lease> {
        let open = self.lanes.iter().filter(|lane| lane.is_open()).count();
        let share = open.div_ceil(2 * actors.max(1)).min(capacity).min(LEASES_AT_ONCE);
        let mut leases = Vec::with_capacity(share);
        for (number, lane) in self.lanes.iter_mut().enumerate() {
            if leases.len() == share {
                break;
            }
            if !lane.is_open() {
                continue;
            }
            lane.holder = Some(Holder { actor: actor.to_owned(), since: now });
            leases.push(Lease {
                source: self.source as i32,
                iteration: self.iteration,
                lane: number as u64,
                policy_version: self.policy_version,
                first_episode: lane.rest.first_episode,
                steps_owed: lane.rest.steps_owed,
                episodes_owed: lane.rest.episodes_owed,
            });
        }
        leases
    }

    /// Takes in a trajectory; returns whether it is new to this rollout. Of an evaluation trajectory, which is
    /// never learned from, it keeps only what an evaluation counts.
    ///
    /// # Errors
    /// When the trajectory names this rollout but is not part of it. Then nothing has changed.
    pub fn receive(&mut self, encoded: Encoded) -> Result<bool, Unusable> {
        let trajectory = &encoded.trajectory;
        if trajectory.source != self.source as i32 || trajectory.iteration != self.iteration {
            return Ok(false);
        }
        let (lane, episode) = (trajectory.lane, trajectory.episode);
        let (expected, found) = (self.policy_version, trajectory.policy_version);
        if expected != found {
            return Err(Unusable::PolicyVersion { lane, episode, expected, found });
        }
        let lanes = self.lanes.len();
        let place = usize::try_from(lane).ok().and_then(|lane| self.lanes.get_mut(lane));
        let place = place.ok_or(Unusable::Lane { lanes, found: lane })?;
        let end = place.plan.end();
        if episode >= end {
            return Err(Unusable::Episode { lane, end, found: episode });
        }
        if let Some(known) = place.received.get(&episode) {
            let (kept, found) = (known.key.hash, encoded.key.hash);
            if kept == found {
                return Ok(false);
            }
            let holder = place.holder.as_ref().map_or("nobody", |holder| &holder.actor).to_owned();
            return Err(Unusable::Differs { lane, episode, kept, found, holder });
        }
        if episode < place.plan.first_episode || place.is_complete() {
            return Ok(false);
        }
        let is_evaluated = self.source == Source::Evaluation;
        place.insert(if is_evaluated { without_bytes(encoded) } else { encoded });
        Ok(true)
    }

    /// Takes a lease back from an actor that will publish no more of it; what is missing is open again.
    pub fn hand_back(&mut self, actor: &str, lease: &Lease) {
        if lease.iteration != self.iteration || lease.source != self.source as i32 {
            return;
        }
        if let Some(lane) = self.lanes.get_mut(lease.lane as usize)
            && lane.holder.as_ref().is_some_and(|holder| holder.actor == actor)
        {
            lane.holder = None;
        }
    }

    /// Reopens the leases whose actors are gone. Returns their number.
    pub fn reopen_lost(&mut self, alive: &[String]) -> usize {
        self.reopen(|holder| !alive.contains(&holder.actor))
    }

    /// Reopens the leases held longer than `timeout`, unless a lease is open already: their holders may only be
    /// slow, and as long as leases are open, other actors have work. Returns their number.
    pub fn reopen_overdue(&mut self, timeout: Duration, now: Instant) -> usize {
        if self.has_open_leases() {
            return 0;
        }
        self.reopen(|holder| now.duration_since(holder.since) > timeout)
    }

    fn reopen(&mut self, is_to_lose: impl Fn(&Holder) -> bool) -> usize {
        let mut reopened = 0;
        for lane in self.lanes.iter_mut().filter(|lane| !lane.is_complete()) {
            if lane.holder.as_ref().is_some_and(&is_to_lose) {
                lane.holder = None;
                reopened += 1;
            }
        }
        reopened
    }

    /// Returns the number of leases that are held and not complete.
    pub fn held(&self) -> usize {
        self.lanes.iter().filter(|lane| lane.holder.is_some() && !lane.is_complete()).count()
    }

    /// Returns the number of leases that an actor holds and has not completed.
    pub fn held_by(&self, actor: &str) -> usize {
        let holds =
            |lane: &&LaneLedger| lane.holder.as_ref().is_some_and(|holder| holder.actor == actor);
        self.lanes.iter().filter(holds).filter(|lane| !lane.is_complete()).count()
    }

    /// Returns the actor that holds a lane's lease.
    pub fn holder(&self, lane: u64) -> Option<&str> {
        let lane = self.lanes.get(usize::try_from(lane).ok()?)?;
        lane.holder.as_ref().map(|holder| holder.actor.as_str())
    }

    /// Returns whether any lease is waiting for an actor.
    pub fn has_open_leases(&self) -> bool {
        self.lanes.iter().any(LaneLedger::is_open)
    }

    /// Returns the number of training steps received.
    pub fn steps(&self) -> u64 {
        if self.source != Source::Training {
            return 0;
        }
        let lane_steps = |lane: &LaneLedger| lane.received.values().map(steps).sum::<u64>();
        self.lanes.iter().map(lane_steps).sum()
    }

    /// Returns whether every lane has run what it owes.
    pub fn is_complete(&self) -> bool {
        self.lanes.iter().all(LaneLedger::is_complete)
    }

    /// Returns the trajectories in batch order: by lane, then by episode.
    pub fn into_batch(self) -> Vec<Encoded> {
        self.lanes.into_iter().flat_map(LaneLedger::into_owed).collect()
    }
}

impl LanePlan {
    /// Returns the first episode number that the lane cannot owe: every episode has at least one step.
    fn end(&self) -> u64 {
        self.first_episode.saturating_add(self.steps_owed.max(self.episodes_owed))
    }
}

impl LaneLedger {
    fn is_open(&self) -> bool {
        self.holder.is_none() && !self.is_complete()
    }

    fn is_complete(&self) -> bool {
        self.rest.steps_owed == 0 && self.rest.episodes_owed == 0
    }

    fn insert(&mut self, encoded: Encoded) {
        self.received.insert(encoded.key.episode, encoded);
        while !self.is_complete()
            && let Some(next) = self.received.get(&self.rest.first_episode)
        {
            self.rest.first_episode += 1;
            self.rest.steps_owed = self.rest.steps_owed.saturating_sub(steps(next));
            self.rest.episodes_owed = self.rest.episodes_owed.saturating_sub(1);
        }
    }

    /// Returns the episodes that were owed, without any beyond them.
    fn into_owed(self) -> impl Iterator<Item = Encoded> {
        let end = self.rest.first_episode;
        self.received.into_iter().take_while(move |(episode, _)| *episode < end).map(|(_, one)| one)
    }
}

/// Returns a trajectory without its encoded bytes, which all of its arrays share; the rewards are copied.
fn without_bytes(encoded: Encoded) -> Encoded {
    let Encoded { trajectory, key, .. } = encoded;
    let trajectory = Trajectory {
        cells: Bytes::new(),
        values: Bytes::new(),
        discrete_actions: Bytes::new(),
        continuous_actions: Bytes::new(),
        log_probs: Bytes::new(),
        environment_rewards: Bytes::copy_from_slice(&trajectory.environment_rewards),
        ..trajectory
    };
    Encoded { trajectory, bytes: Bytes::new(), key }
}

fn steps(encoded: &Encoded) -> u64 {
    u64::from(encoded.trajectory.steps)
}
