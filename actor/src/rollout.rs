//! `goalward-actor rollout`: pulls leases from the learner and publishes their trajectories.
//!
//! An actor steps several lanes at once so that inference is batched; fewer if their environment is slow. It
//! asks for more leases as lanes come free, so faster actors take more. It may come and go at any moment: the
//! learner grants again what it leaves undone.

use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use bus::{NewestSubscriber, POLICY_VERSIONS};
use bytes::Bytes;
use prost::Message;
use protocol::dropped::Dropped;
use protocol::messages::Lease;
use protocol::trajectory::Encoded;
use protocol::weights::Weights;
use run::config::RunConfig;
use run::folder::RunFolder;
use run::process::{Final, Stop};

use crate::episode::{Episode, would_fail_again};
use crate::factory::{Factory, Tasks};
use crate::lane::Lane;
use crate::pace::{LANES_AT_ONCE, Pace};
use crate::policy::{Policy, Version};
use crate::ports::Ports;

/// How long to wait for the policy version of a lease. The learner, or the gateway in its place, publishes the
/// version before it grants the lease, and hands it to a late actor as soon as that actor asks. A version that
/// has not arrived by then belongs to a learner that is gone.
const VERSION_PATIENCE: Duration = Duration::from_secs(1);

/// An actor at work.
struct Actor {
    config: RunConfig,
    factory: Factory,
    policy: Policy,
    versions: Vec<Version>,
    lanes: Vec<Lane>,
    pace: Pace,
    /// Episodes of finished lanes, whose environments are reused: building one costs more than resetting one.
    rested: Vec<Episode>,
    awaited: Awaited,
    ports: Ports,
    weights: NewestSubscriber,
    dropped: Dropped,
}

/// Runs leases until the run is over or a stop is requested.
///
/// # Errors
/// When the task is not among `tasks`, or an environment or the bus fails.
pub(crate) fn rollout(tasks: Tasks, folder: &RunFolder, name: &str, stop: &Stop) -> Result<()> {
    let config = folder.config()?;
    let factory = Factory::of_run(tasks, &config)?;
    let (ports, bus) = Ports::open(folder, name, stop)?;
    let mut actor = Actor {
        policy: Policy::new(&config),
        config,
        factory,
        versions: Vec::new(),
        lanes: Vec::new(),
        pace: Pace::default(),
        rested: Vec::new(),
        awaited: Awaited::default(),
        ports,
        weights: bus.weights_subscriber()?,
        dropped: Dropped::new("weights"),
    };
    while !actor.ports.is_over()? {
        actor.turn().map_err(unless_again)?;
    }
    Ok(())
}

/// Makes an error final, so that it ends the run, if the same lease would lead to it again.
fn unless_again(error: anyhow::Error) -> anyhow::Error {
    if would_fail_again(&error) { Final(format!("{error:#}")).into() } else { error }
}

impl Actor {
    fn turn(&mut self) -> Result<()> {
        self.take_weights()?;
        let leases = self.ports.granted();
        self.begin(&leases)?;
        self.ask();
        let acting = self.lanes.first().map(|lane| lane.lease.policy_version);
        let version = self.versions.iter().find(|version| Some(version.number) == acting);
        let is_given_up = self.awaited.is_given_up(acting, version.is_some(), Instant::now());
        let Some(version) = version else {
            if is_given_up {
                self.hand_back();
            }
            return self.ports.wait();
        };
        let choice = self.config.evaluation.actions_of(self.lanes[0].source());
        let count = self.pace.at_once().min(self.lanes.len());
        let before = self.policy.seconds.environment;
        let trajectories = self.policy.step(version, &mut self.lanes[..count], choice)?;
        self.pace.note(self.policy.seconds.environment - before, count);
        if trajectories.is_empty() {
            return Ok(());
        }
        let begun = Instant::now();
        for trajectory in trajectories {
            self.ports.publish(&Encoded::encode(trajectory))?;
        }
        self.policy.seconds.transport += begun.elapsed().as_secs_f64();
        for lane in self.lanes.extract_if(.., |lane| lane.is_done()) {
            self.ports.finish(lane.lease);
            self.rested.push(lane.episode);
        }
        // A reader that is woken finds the lease request together with the trajectories.
        self.ask();
        self.ports.ring()
    }

    fn ask(&mut self) {
        let free = self.pace.held().saturating_sub(self.lanes.len());
        self.ports.ask(free, &mut self.policy.seconds);
    }

    /// Drops all lanes and reports their leases as finished, so that the learner can grant them again.
    fn hand_back(&mut self) {
        tracing::info!("{} leases handed back: their policy is gone", self.lanes.len());
        self.lanes.drain(..).for_each(|lane| self.ports.finish(lane.lease));
    }

    fn take_weights(&mut self) -> Result<()> {
        while let Some(bytes) = self.weights.receive()? {
            let version = match self.version(bytes) {
                Ok(version) => version,
                Err(why) => {
                    self.dropped.note(format!("{why:#}"));
                    continue;
                }
            };
            self.versions.retain(|known| known.number != version.number);
            self.versions.push(version);
            if self.versions.len() > POLICY_VERSIONS {
                self.versions.remove(0);
            }
        }
        Ok(())
    }

    fn version(&self, bytes: Bytes) -> Result<Version> {
        let weights = Weights::decode(bytes).context("undecodable weights")?;
        self.policy.version(&weights)
    }

    /// Begins leases. Lanes of another rollout are dropped, because nobody waits for them any more.
    fn begin(&mut self, leases: &[Lease]) -> Result<()> {
        let Some(first) = leases.first() else { return Ok(()) };
        let rollout = |lease: &Lease| (lease.source, lease.iteration);
        self.lanes.retain(|lane| rollout(&lane.lease) == rollout(first));
        for lease in leases.iter().take(LANES_AT_ONCE - self.lanes.len()) {
            let earlier = self.rested.pop();
            self.lanes.push(Lane::begin(*lease, &self.factory, earlier, self.config.seed)?);
        }
        Ok(())
    }
}

/// The policy version that lanes are waiting for, and since when.
#[derive(Debug, Default)]
struct Awaited(Option<(u64, Instant)>);

impl Awaited {
    /// Returns whether the lanes have waited too long for the version `acting`, which is `None` if there are no lanes.
    fn is_given_up(&mut self, acting: Option<u64>, is_here: bool, now: Instant) -> bool {
        let Some(number) = acting.filter(|_| !is_here) else {
            self.0 = None;
            return false;
        };
        match self.0 {
            Some((awaited, since)) if awaited == number => {
                now.duration_since(since) >= VERSION_PATIENCE
            }
            _ => {
                self.0 = Some((number, now));
                false
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_version_that_does_not_come_is_given_up_and_one_that_is_late_is_not() {
        let start = Instant::now();
        let mut awaited = Awaited::default();
        let mut look = |milliseconds, acting, is_here| {
            awaited.is_given_up(acting, is_here, start + Duration::from_millis(milliseconds))
        };
        assert!(!look(0, None, false), "an actor without lanes waits for nothing");
        assert!(!look(5_000, Some(7), false), "a lease may be faster than its weights");
        assert!(!look(5_900, Some(7), false));
        assert!(!look(5_950, Some(7), true), "it has come");
        assert!(!look(7_000, Some(7), false), "evicted while lanes were under way");
        assert!(!look(7_900, Some(8), false), "another version is waited for anew");
        assert!(look(8_900, Some(8), false));
        assert!(!look(8_901, None, false));
    }
}
