//! A policy that acts: one version of the weights, and actions for several lanes at once.

use std::time::Instant;

use anyhow::{Result, ensure};
use export::Graph;
use networks::{
    ActorCritic, Batch, PolicyArchitecture, PolicyWorkspace, PreparedPolicy, RunningNormalizer,
};
use protocol::messages::ActorSeconds;
use protocol::seed::{self, Purpose};
use protocol::task::{ObservationSpec, Spec};
use protocol::trajectory::Trajectory;
use protocol::weights::Weights;
use run::config::{ActionChoice, RunConfig};

use crate::episode::would_fail_again;
use crate::lane::Lane;

/// A policy and the memory it acts with.
pub struct Policy {
    spec: Spec,
    network: ActorCritic,
    workspace: PolicyWorkspace,
    observations: Vec<u8>,
    actions: Vec<u8>,
    log_probs: Vec<f32>,
    /// Where time went since this was last reset.
    pub seconds: ActorSeconds,
}

/// One version of a policy, ready to act.
pub struct Version {
    /// Number of updates it has had.
    pub number: u64,
    normalizer: RunningNormalizer,
    prepared: PreparedPolicy,
}

/// Returns how many numbers of an observation can be normalized.
fn normalized_numbers(spec: &Spec) -> usize {
    match spec.observation {
        ObservationSpec::Cells { .. } => 0,
        ObservationSpec::Vector { len } => len,
    }
}

impl Policy {
    /// Creates the policy of a run's configuration.
    pub fn new(config: &RunConfig) -> Policy {
        let spec = config.task.spec();
        let architecture = PolicyArchitecture::from(&config.policy);
        Policy {
            spec,
            network: ActorCritic::new(spec.observation, spec.action, &architecture),
            workspace: PolicyWorkspace::default(),
            observations: Vec::new(),
            actions: Vec::new(),
            log_probs: Vec::new(),
            seconds: ActorSeconds::default(),
        }
    }

    /// Prepares weights for acting.
    ///
    /// # Errors
    /// When they are not finite, or do not have as many numbers as this policy.
    pub fn version(&self, weights: &Weights) -> Result<Version> {
        let (parameters, normalizer) = self.checked(weights)?;
        let prepared = self.network.prepare(&parameters);
        Ok(Version { number: weights.version, normalizer, prepared })
    }

    /// Returns untrained weights, which take observations as they are.
    pub fn initial_weights(&self, run_seed: u64) -> Weights {
        let mut stream = seed::stream(run_seed, Purpose::PolicyWeights, 0, 0);
        Weights::new(0, &self.network.initial_parameters(&mut stream), &[])
    }

    /// Returns a version of this policy as a graph whose actions are already multiplied by the run's action scale.
    ///
    /// # Errors
    /// As [`Policy::version`].
    pub fn graph(&self, weights: &Weights, scale: &[f32]) -> Result<Graph> {
        let (parameters, normalizer) = self.checked(weights)?;
        Ok(export::policy(&self.network, &parameters, &normalizer, scale))
    }

    /// Returns the parameters of weights and their normalizer of observations.
    ///
    /// # Errors
    /// As [`Policy::version`].
    fn checked(&self, weights: &Weights) -> Result<(Vec<f32>, RunningNormalizer)> {
        let parameters = weights.parameter_numbers();
        let (expected, found) = (self.network.parameter_count(), parameters.len());
        ensure!(expected == found, "weights: expected {expected} parameters, found {found}");
        let moments = weights.moment_numbers();
        ensure!(
            parameters.iter().all(|number| number.is_finite())
                && moments.iter().all(|number| number.is_finite()),
            "weights of version {}: expected finite parameters and moments",
            weights.version
        );
        let normalizer = RunningNormalizer::from_numbers(&moments);
        let (expected, found) = (normalized_numbers(&self.spec), normalizer.moments.len());
        ensure!(
            found == 0 || found == expected,
            "weights: expected moments of {expected} numbers or none, found {found}"
        );
        Ok((parameters, normalizer))
    }

    /// Takes one step in every lane and returns the trajectories of the episodes that ended. A lane's actions
    /// do not depend on the other lanes.
    ///
    /// # Errors
    /// When an environment fails.
    pub fn step(
        &mut self,
        version: &Version,
        lanes: &mut [Lane],
        choice: ActionChoice,
    ) -> Result<Vec<Trajectory>> {
        let begun = Instant::now();
        self.choose(version, lanes, choice);
        let chosen = Instant::now();
        let actions = self.actions.chunks_exact(self.spec.action.bytes());
        for (lane, action) in lanes.iter_mut().zip(actions.clone()) {
            lane.episode.announce(action)?;
        }
        let mut trajectories = Vec::new();
        let mut failure = None;
        for ((lane, action), log_prob) in lanes.iter_mut().zip(actions).zip(&self.log_probs) {
            match lane.step(action, Some(*log_prob)) {
                Ok(trajectory) => trajectories.extend(trajectory),
                Err(error) if would_fail_again(&error) => return Err(error),
                // Lanes whose environments share a process fail together: an error that an environment raised
                // takes precedence.
                Err(error) => failure = failure.or(Some(error)),
            }
        }
        if let Some(error) = failure {
            return Err(error);
        }
        self.seconds.inference += (chosen - begun).as_secs_f64();
        self.seconds.environment += chosen.elapsed().as_secs_f64();
        Ok(trajectories)
    }

    /// Chooses an action for every lane.
    fn choose(&mut self, version: &Version, lanes: &mut [Lane], choice: ActionChoice) {
        self.observations.clear();
        for lane in &*lanes {
            self.observations.extend(lane.episode.observation());
        }
        version.normalizer.normalize(&mut self.observations);
        let batch = Batch::new(&self.observations);
        let outputs = self.network.act(&version.prepared, batch, &mut self.workspace);
        let distribution = self.network.distribution();
        let rows = outputs.as_slice().chunks_exact(outputs.nrows());
        let bytes = self.spec.action.bytes();
        self.actions.resize(lanes.len() * bytes, 0);
        self.log_probs.clear();
        let actions = self.actions.chunks_exact_mut(bytes);
        for ((lane, parameters), action) in lanes.iter_mut().zip(rows).zip(actions) {
            self.log_probs.push(match choice {
                ActionChoice::Sample => {
                    distribution.sample(parameters, lane.episode.action_stream(), action)
                }
                ActionChoice::Mode => {
                    distribution.mode(parameters, action);
                    distribution.log_probability(parameters, action)
                }
            });
        }
    }
}
