//! Soft Q-learning for discrete actions: `V(s) = temperature x log sum exp(Q(s, a) / temperature)`, and the
//! corresponding policy has the logits `Q / temperature`.

use networks::{ActorCritic, Distribution, WindowIndex, log_sum_exp};
use protocol::seed::Stream;
use protocol::tensors::Tensors;
use run::config::{PpoConfig, RunConfig, SqilConfig};

use super::{Minibatch, SoftLearner, polyak_update};
use crate::algorithm::Metrics;
use crate::algorithm::policy_trainer::{PolicyTrainer, RowLoss, RowOutput};

/// A soft Q-learner. Its Q-function has the policy's shape: its outputs for the actions are the policy's logits
/// times the temperature.
pub(super) struct SoftQ {
    trainer: PolicyTrainer,
    /// Parameters of the Q-function; empty before the first update.
    parameters: Vec<f32>,
    target_parameters: Vec<f32>,
    config: SqilConfig,
}

impl SoftQ {
    pub(super) fn new(config: &RunConfig, own: &SqilConfig, network: ActorCritic) -> SoftQ {
        let PpoConfig { adam_epsilon, max_gradient_norm, .. } = config.ppo;
        SoftQ {
            trainer: PolicyTrainer::new(network, adam_epsilon, max_gradient_norm),
            parameters: Vec::new(),
            target_parameters: Vec::new(),
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
            self.target_parameters.clone_from(policy);
        }
        let SqilConfig { temperature, gamma, target_rate, .. } = self.config;
        let value = |outputs: &[f32]| log_sum_exp(outputs, temperature as f32);
        let next = &minibatch.next_observations;
        let next_values = self.trainer.outputs(&self.target_parameters, next, value);
        let loss = Bellman {
            targets: minibatch.targets(&next_values, gamma as f32),
            actions: &minibatch.actions,
            temperature: temperature as f32,
            distribution: self.trainer.network().distribution(),
            weight: 1.0 / minibatch.len() as f32,
        };
        let rows: Vec<u32> = (0..minibatch.len() as u32).collect();
        let mut windows = WindowIndex::default();
        let observations = self.trainer.index(&minibatch.observations, &mut windows);
        let parameters = &mut self.parameters;
        let metrics = self.trainer.step(parameters, observations, &rows, &loss, learning_rate);
        polyak_update(&mut self.target_parameters, &self.parameters, target_rate);
        policy.clone_from(&self.parameters);
        self.trainer.network().scale_actor(policy, (1.0 / temperature) as f32);
        metrics
    }

    fn save(&self, tensors: &mut Tensors) {
        self.trainer.save("q.adam", tensors);
        tensors.put_f32("q.parameters", self.parameters.iter().copied());
        tensors.put_f32("q.targets", self.target_parameters.iter().copied());
    }

    fn restore(&mut self, tensors: &Tensors) -> Result<(), String> {
        self.trainer.restore("q.adam", tensors)?;
        let begun = !tensors.f32("q.parameters")?.is_empty();
        let count = if begun { self.trainer.network().parameter_count() } else { 0 };
        self.parameters = tensors.exactly("q.parameters", count, Tensors::f32)?;
        self.target_parameters = tensors.exactly("q.targets", count, Tensors::f32)?;
        Ok(())
    }
}

/// Half the squared Bellman error of the actions taken.
struct Bellman<'a> {
    targets: Vec<f32>,
    actions: &'a [u8],
    temperature: f32,
    distribution: Distribution,
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
        let logits: Vec<f32> = output.parameters.iter().map(|q| q / self.temperature).collect();
        let entropy = f64::from(self.weight * self.distribution.entropy(&logits));
        (Metrics { value_loss, entropy, ..Metrics::default() }, 0.0)
    }
}

#[cfg(test)]
mod tests {
    use protocol::seed::{Purpose, stream};

    use super::*;
    use networks::PolicyArchitecture;

    #[test]
    fn the_policy_is_the_softmax_of_q_over_the_temperature() {
        let settings = ["method=sqil", "sqil.temperature=0.1"].map(str::to_owned);
        let config = run::tasks::configuration("navigation", None, &settings).unwrap();
        let spec = config.task.spec();
        let architecture = PolicyArchitecture::from(&config.policy);
        let network = ActorCritic::new(spec.observation, spec.action, &architecture);
        let mut draws = stream(1, Purpose::PolicyWeights, 0, 0);
        let mut policy = network.initial_parameters(&mut draws);
        network.scale_actor(&mut policy, 1000.0);
        let distribution = network.distribution();
        let mut learner = SoftQ::new(&config, config.sqil.as_ref().unwrap(), network);
        let observations = vec![1; 2 * spec.observation.bytes()];
        let minibatch = Minibatch {
            observations: observations.clone(),
            actions: vec![0, 3],
            next_observations: observations.clone(),
            rewards: vec![1.0, 0.0],
            end_values: vec![None, None],
        };
        // With a rate of 0 the entropy is of the weights that act afterwards.
        let metrics = learner.update(&mut policy, &minibatch, &mut draws, 0.0);
        let (trainer, q) = (&mut learner.trainer, &learner.parameters);
        let [q, logits] =
            [q, &policy].map(|own| trainer.outputs(own, &observations, <[f32]>::to_vec));
        for (q, logit) in q.concat().iter().zip(logits.concat()) {
            assert!((logit * 0.1 - q).abs() < 1e-5, "{logit} for {q}");
        }
        let entropy = f64::from(distribution.entropy(&logits[0]));
        assert!((metrics.entropy - entropy).abs() < 1e-5, "{metrics:?}, {entropy}");
        assert!((0.1..1.386).contains(&entropy), "{entropy}");
    }
}
