//! A policy that acts: one version of the weights, and actions for several lanes at once.

use anyhow::{Result, ensure};
use networks::{ActorCritic, Batch, PolicyArchitecture, PolicyWorkspace, PreparedPolicy};
use protocol::config::{ActionChoice, RunConfig};
use protocol::task::Spec;
use protocol::trajectory::Trajectory;
use protocol::weights::Weights;

use crate::lane::Lane;

/// A policy and the memory it acts with.
pub struct Policy {
    spec: Spec,
    network: ActorCritic,
    workspace: PolicyWorkspace,
    observations: Vec<u8>,
    action: Vec<u8>,
}

/// One version of a policy, ready to act.
pub struct Version {
    /// Updates it has had.
    pub number: u64,
    prepared: PreparedPolicy,
}

impl Policy {
    /// The policy of a run's configuration.
    pub fn new(config: &RunConfig) -> Policy {
        let spec = config.task.spec();
        let architecture = PolicyArchitecture::from(&config.policy);
        Policy {
            spec,
            network: ActorCritic::new(spec.observation, spec.action, &architecture),
            workspace: PolicyWorkspace::default(),
            observations: Vec::new(),
            action: vec![0; spec.action.bytes()],
        }
    }

    /// Makes weights ready to act.
    pub fn version(&self, weights: &Weights) -> Result<Version> {
        let parameters = weights.numbers();
        let (expected, found) = (self.network.parameter_count(), parameters.len());
        ensure!(expected == found, "weights: expected {expected} parameters, found {found}");
        ensure!(
            parameters.iter().all(|number| number.is_finite()),
            "weights of version {}: expected finite parameters",
            weights.version
        );
        Ok(Version { number: weights.version, prepared: self.network.prepare(&parameters) })
    }

    /// Takes one step in every lane. A lane's actions do not depend on the lanes beside it.
    /// Returns the trajectories of episodes that ended.
    pub fn step(
        &mut self,
        version: &Version,
        lanes: &mut [Lane],
        choice: ActionChoice,
    ) -> Result<Vec<Trajectory>> {
        self.observations.clear();
        for lane in &*lanes {
            self.observations.extend(lane.episode.observation());
        }
        let batch = Batch::new(&self.observations);
        let outputs = self.network.act(&version.prepared, batch, &mut self.workspace);
        let distribution = self.network.distribution();
        let rows = outputs.as_slice().chunks_exact(outputs.nrows());
        let mut trajectories = Vec::new();
        for (lane, parameters) in lanes.iter_mut().zip(rows) {
            let action = &mut self.action;
            debug_assert_eq!(action.len(), self.spec.action.bytes());
            let log_prob = match choice {
                ActionChoice::Sample => {
                    distribution.sample(parameters, lane.episode.action_stream(), action)
                }
                ActionChoice::Mode => {
                    distribution.mode(parameters, action);
                    distribution.log_probability(parameters, action)
                }
            };
            trajectories.extend(lane.step(action, Some(log_prob))?);
        }
        Ok(trajectories)
    }
}
