//! Soft Q-learning for discrete actions: `V(s) = temperature x log sum exp(Q(s, a) / temperature)`, and the
//! corresponding policy has the logits `Q / temperature`.

use networks::{ActorCritic, WindowIndex, log_sum_exp};
use protocol::seed::Stream;
use protocol::tensors::Tensors;
use run::config::{PpoConfig, RunConfig, SqilConfig};

use super::{Minibatch, SoftLearner, follow};
use crate::algorithm::Metrics;
use crate::algorithm::policy_trainer::{PolicyTrainer, RowLoss, RowOutput};

/// A soft Q-learner. Its Q-function has the policy's shape: its outputs for the actions are the policy's logits
/// times the temperature.
pub(super) struct SoftQ {
    trainer: PolicyTrainer,
    /// Parameters of the Q-function; empty before the first update.
    parameters: Vec<f32>,
    targets: Vec<f32>,
    config: SqilConfig,
}

impl SoftQ {
    pub(super) fn new(config: &RunConfig, own: &SqilConfig, network: ActorCritic) -> SoftQ {
        let PpoConfig { adam_epsilon, max_gradient_norm, .. } = config.ppo;
        SoftQ {
            trainer: PolicyTrainer::new(network, adam_epsilon, max_gradient_norm),
            parameters: Vec::new(),
            targets: Vec::new(),
            config: own.clone(),
        }
    }
}

impl SoftLearner for SoftQ {
    fn update(
        &mut self,
        policy: &mut Vec<f32>,
        minibatch: &Minibatch,
        _stream: &mut Stream,
        learning_rate: f64,
    ) -> Metrics {
        if self.parameters.is_empty() {
            self.parameters.clone_from(policy);
            self.targets.clone_from(policy);
        }
        let SqilConfig { temperature, gamma, target_rate, .. } = self.config;
        let value = |outputs: &[f32]| log_sum_exp(outputs, temperature as f32);
        let next = &minibatch.next_observations;
        let next_values = self.trainer.outputs(&self.targets, next, value);
        let loss = Bellman {
            targets: minibatch.targets(&next_values, gamma as f32),
            actions: &minibatch.actions,
            weight: 1.0 / minibatch.len() as f32,
        };
        let rows: Vec<u32> = (0..minibatch.len() as u32).collect();
        let mut windows = WindowIndex::default();
        let observations = self.trainer.index(&minibatch.observations, &mut windows);
        let parameters = &mut self.parameters;
        let metrics = self.trainer.step(parameters, observations, &rows, &loss, learning_rate);
        follow(&mut self.targets, &self.parameters, target_rate);
        policy.clone_from(&self.parameters);
        self.trainer.network().scale_actor(policy, (1.0 / temperature) as f32);
        metrics
    }

    fn save(&self, tensors: &mut Tensors) {
        self.trainer.save("q.adam", tensors);
        tensors.put_f32("q.parameters", self.parameters.iter().copied());
        tensors.put_f32("q.targets", self.targets.iter().copied());
    }

    fn restore(&mut self, tensors: &Tensors) -> Result<(), String> {
        self.trainer.restore("q.adam", tensors)?;
        let begun = !tensors.f32("q.parameters")?.is_empty();
        let count = if begun { self.trainer.network().parameter_count() } else { 0 };
        self.parameters = tensors.exactly("q.parameters", count, Tensors::f32)?;
        self.targets = tensors.exactly("q.targets", count, Tensors::f32)?;
        Ok(())
    }
}

/// Half the squared Bellman error of the actions taken.
struct Bellman<'a> {
    targets: Vec<f32>,
    actions: &'a [u8],
    /// One over the number of rows.
    weight: f32,
}

impl RowLoss for Bellman<'_> {
    const OF_VALUES: bool = false;

    fn of_row(&self, row: usize, output: RowOutput<'_>, gradients: &mut [f32]) -> (Metrics, f32) {
        let action = usize::from(self.actions[row]);
        let error = output.parameters[action] - self.targets[row];
        gradients.fill(0.0);
        gradients[action] = self.weight * error;
        let value_loss = 0.5 * f64::from(self.weight * error * error);
        (Metrics { value_loss, ..Metrics::default() }, 0.0)
    }
}
