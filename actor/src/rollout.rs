//! `goalward-actor rollout`: pulls leases from the learner and publishes their trajectories.
//!
//! An actor keeps several lanes going at once, so that inference is batched, and asks for more as
//! lanes come free: faster actors take more. It may come and go at any moment; what it leaves undone
//! the learner hands out again.

use std::time::Instant;

use anyhow::{Context, Result};
use prost::Message;
use protocol::bus::{NewestSubscriber, SharedMemory};
use protocol::config::{ActionChoice, RunConfig};
use protocol::messages::Lease;
use protocol::process::Stop;
use protocol::run::RunFolder;
use protocol::trajectory::{Encoded, Source};
use protocol::weights::Weights;

use crate::lane::Lane;
use crate::policy::{Policy, Version};
use crate::ports::Ports;

/// Lanes an actor keeps going at once.
const LANES_AT_ONCE: usize = 16;

/// Versions of the policy kept: with lag 1 the one before the newest still acts.
const VERSIONS_KEPT: usize = 2;

/// An actor at work.
struct Actor {
    config: RunConfig,
    policy: Policy,
    versions: Vec<Version>,
    lanes: Vec<Lane>,
    ports: Ports,
    weights: NewestSubscriber<SharedMemory>,
}

/// Acts until the run is over or a stop is requested.
pub fn rollout(folder: &RunFolder, name: &str, stop: &Stop) -> Result<()> {
    let config = folder.config()?;
    let (ports, bus) = Ports::open(folder, name)?;
    let mut actor = Actor {
        policy: Policy::new(&config),
        config,
        versions: Vec::new(),
        lanes: Vec::new(),
        ports,
        weights: bus.weights_subscriber()?,
    };
    while !stop.is_requested() && !actor.ports.is_over() {
        actor.turn()?;
    }
    Ok(())
}

impl Actor {
    fn turn(&mut self) -> Result<()> {
        self.take_weights()?;
        let leases = self.ports.granted()?;
        self.begin(&leases)?;
        let free = LANES_AT_ONCE - self.lanes.len();
        self.ports.ask(free, &mut self.policy.seconds);
        let acting = self.lanes.first().map(|lane| lane.lease.policy_version);
        let version = self.versions.iter().find(|version| Some(version.number) == acting);
        let Some(version) = version else { return self.ports.wait() };
        let evaluates = self.lanes[0].lease.source == Source::Evaluation as i32;
        let choice = if evaluates { self.config.evaluation.actions } else { ActionChoice::Sample };
        let trajectories = self.policy.step(version, &mut self.lanes, choice)?;
        let begun = Instant::now();
        for trajectory in trajectories {
            self.ports.publish(&Encoded::encode(trajectory))?;
        }
        self.policy.seconds.transport += begun.elapsed().as_secs_f64();
        for lane in self.lanes.extract_if(.., |lane| lane.is_done()) {
            self.ports.finish(lane.lease);
        }
        Ok(())
    }

    fn take_weights(&mut self) -> Result<()> {
        while let Some(bytes) = self.weights.receive()? {
            let weights = Weights::decode(bytes).context("weights")?;
            let version = self.policy.version(&weights)?;
            self.versions.retain(|known| known.number != version.number);
            self.versions.push(version);
            if self.versions.len() > VERSIONS_KEPT {
                self.versions.remove(0);
            }
        }
        Ok(())
    }

    /// Begins leases. Older ones of another rollout are dropped: nobody waits for them any more.
    fn begin(&mut self, leases: &[Lease]) -> Result<()> {
        let Some(first) = leases.first() else { return Ok(()) };
        let rollout = |lease: &Lease| (lease.source, lease.iteration);
        self.lanes.retain(|lane| rollout(&lane.lease) == rollout(first));
        for lease in leases {
            let RunConfig { task, environment, seed, .. } = &self.config;
            self.lanes.push(Lane::begin(*lease, *task, environment, *seed)?);
        }
        Ok(())
    }
}
