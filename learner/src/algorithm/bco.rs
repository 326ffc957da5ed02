//! Behavioral cloning from observation (Torabi et al., 2018a; paper, Section 4.1). An inverse dynamics model,
//! fitted to the agent's own transitions, infers the actions of the demonstrations, and the policy is cloned
//! from these. Both are trained further as the policy gathers new transitions.

use anyhow::{Context, Result};
use networks::{ActorCritic, PolicyArchitecture, RunningNormalizer};
use protocol::messages::Score;
use protocol::seed::{self, Purpose};
use protocol::tensors::Tensors;
use protocol::trajectory::Encoded;
use rand::seq::SliceRandom;
use run::config::{CloningConfig, InverseDynamicsConfig};

use crate::algorithm::bc::settings;
use crate::algorithm::cloning::{Cloning, Pairs};
use crate::algorithm::replay_buffer::ReplayBuffer;
use crate::algorithm::{Metrics, PolicyLearner, Schedule, Setup};
use crate::state::PolicyState;

/// The learner of behavioral cloning from observation.
pub(super) struct Bco {
    config: InverseDynamicsConfig,
    cloning_config: CloningConfig,
    normalizer: RunningNormalizer,
    inverse: Cloning,
    inverse_parameters: Vec<f32>,
    policy: Cloning,
    replay_buffer: ReplayBuffer,
    /// Pairs of successive observations in the demonstrations.
    transitions: Vec<u8>,
    /// The first observation of each pair, and the action inferred for it.
    pairs: Pairs,
}

impl Bco {
    /// Creates an untrained learner.
    pub(super) fn new(of: Setup<'_>) -> Bco {
        let Setup { config, network, normalizer, demonstrations } = of;
        let spec = config.task.spec();
        let cloning = config.cloning.clone().expect("checked with the configuration");
        let inverse = config.inverse_dynamics.clone().expect("checked with the configuration");
        let model = ActorCritic::new(spec.observation, spec.action, &architecture(&inverse));
        let mut stream = seed::stream(config.seed, Purpose::InverseDynamicsWeights, 0, 0);
        let (one, action) = (spec.observation.bytes(), spec.action.bytes());
        let expert = ReplayBuffer::of_demonstrations(spec, demonstrations);
        let mut transitions = Vec::new();
        let mut pairs = Pairs::default();
        for position in 0..expert.len() {
            let observations = expert.get(position).observations;
            transitions.extend(observations);
            pairs.observations.extend(&observations[..one]);
        }
        normalizer.normalize(&mut transitions);
        normalizer.normalize(&mut pairs.observations);
        let mut inverse_settings = settings(&cloning);
        inverse_settings.batch = inverse.batch;
        Bco {
            inverse_parameters: model.initial_parameters(&mut stream),
            inverse: Cloning::new(model, action, inverse_settings),
            policy: Cloning::new(network, action, settings(&cloning)),
            replay_buffer: ReplayBuffer::new(spec, inverse.experience),
            normalizer: normalizer.clone(),
            config: inverse,
            cloning_config: cloning,
            transitions,
            pairs,
        }
    }

    /// Fits the inverse dynamics model to transitions sampled from the agent's own.
    fn improve_inverse(&mut self, schedule: &Schedule) -> Result<()> {
        let Schedule { run_seed, iteration, .. } = *schedule;
        let mut stream = seed::stream(run_seed, Purpose::InverseDynamicsBatches, iteration, 0);
        let count = self.config.samples.min(self.replay_buffer.len());
        let drawn = rand::seq::index::sample(&mut stream, self.replay_buffer.len(), count);
        let mut pairs = Pairs::default();
        for position in drawn {
            let transition = self.replay_buffer.get(position);
            pairs.observations.extend(transition.observations);
            pairs.actions.extend(transition.action);
        }
        self.normalizer.normalize(&mut pairs.observations);
        let rows: Vec<u32> = (0..count as u32).collect();
        let rate = self.config.learning_rate;
        let trained = self.inverse.train(&mut self.inverse_parameters, &pairs, &rows, rate);
        trained.context("inverse dynamics model")?;
        Ok(())
    }
}

/// Returns the architecture of the inverse dynamics model: the action distribution of a policy that sees two
/// observations.
fn architecture(config: &InverseDynamicsConfig) -> PolicyArchitecture {
    PolicyArchitecture {
        cells: config.encoder(),
        hidden: config.hidden.clone(),
        frames: 2,
        ..PolicyArchitecture::default()
    }
}

impl PolicyLearner for Bco {
    fn update(
        &mut self,
        policy: &mut PolicyState,
        trajectories: &[Encoded],
        _scores: &[Score],
        schedule: &Schedule,
    ) -> Result<Metrics> {
        self.remember(trajectories);
        if self.replay_buffer.steps() < self.config.exploration_steps {
            return Ok(Metrics::default());
        }
        self.improve_inverse(schedule)?;
        self.pairs.actions = self.inverse.modes(&self.inverse_parameters, &self.transitions);
        let count = self.transitions.len() / self.inverse.row_bytes();
        let mut rows: Vec<u32> = (0..count as u32).collect();
        let mut metrics = Metrics::default();
        for pass in 0..self.cloning_config.epochs {
            let Schedule { run_seed, iteration, learning_rate } = *schedule;
            rows.shuffle(&mut seed::stream(run_seed, Purpose::CloningBatches, iteration, pass));
            let parameters = &mut policy.parameters;
            metrics += self.policy.train(parameters, &self.pairs, &rows, learning_rate)?;
        }
        Ok(metrics.divided_by(self.cloning_config.epochs as f64))
    }

    fn remember(&mut self, trajectories: &[Encoded]) {
        trajectories.iter().for_each(|encoded| self.replay_buffer.push(&encoded.trajectory));
    }

    fn save(&self, tensors: &mut Tensors) {
        self.policy.save("adam", tensors);
        self.inverse.save("inverse.adam", tensors);
        tensors.put_f32("inverse.parameters", self.inverse_parameters.iter().copied());
    }

    fn restore(&mut self, tensors: &Tensors) -> Result<(), String> {
        self.policy.restore("adam", tensors)?;
        self.inverse.restore("inverse.adam", tensors)?;
        let count = self.inverse_parameters.len();
        self.inverse_parameters = tensors.exactly("inverse.parameters", count, Tensors::f32)?;
        Ok(())
    }
}
